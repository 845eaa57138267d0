// What is known of each pixel of view 1, or of every so many, in metres, with the numbers of the maps behind it.

const [KNOWN, UNOCCLUDED, IN_FIELD_2, SIDEWAYS, WALL] = [1, 2, 4, 8, 16];
const VISIBLE = KNOWN | UNOCCLUDED | IN_FIELD_2;

class Pixels {
  constructor(facts, maps) {
    Object.assign(this, { facts, maps, steps: facts.steps, panorama: new Panorama(facts.grid, facts.every) });
    const tables = facts.views.map((view, number) => {
      const source = facts.views[view.table];
      const [rows, columns] = facts.arrays[`u${view.table}`];
      const table = { frame: source.frame, thetaMax: source.thetaMax, size: [rows, columns] };
      return new Projection(view, table, maps, view.table, facts.steps.pixel);
    });
    this.projections = tables;
  }

  // Metres; NaN where there is no surface, or no estimate.
  trueRange(i) {
    return this.maps.seen[i] & KNOWN ? this.maps.trueRange[i] * this.steps.trueRange : NaN;
  }

  range(method, i) {
    return this.maps[`reason${method}`][i] === 0 ? this.maps[`range${method}`][i] * this.facts.methods[method].step : NaN;
  }

  error(method, i) {
    return this.range(method, i) - this.trueRange(i);
  }

  sigma(method, i) {
    const step = this.maps[`sigma${method}`][i];
    return step ? this.steps.leastSigma * 2 ** ((step - 1) / this.steps.octave) : NaN;
  }

  reason(method, i) {
    return this.maps[`reason${method}`][i];
  }

  // What is seen of the true point: an index into `OCCLUSION`.
  occlusion(i) {
    const seen = this.maps.seen[i];
    if (!(seen & KNOWN)) return 4;
    if (!(seen & IN_FIELD_2)) return 3;
    if (!(seen & UNOCCLUDED)) return 2;
    return seen & SIDEWAYS ? 0 : 1;
  }

  surface(i) {
    const seen = this.maps.seen[i];
    return !(seen & KNOWN) ? "nothing there" : seen & WALL ? "wall" : "floor or ceiling";
  }

  curve(row, column, given = true) {
    const motion = given ? this.facts.given : this.facts.true;
    return new Curve(this.panorama, motion.t, this.facts.cost, row, column);
  }

  // The direction of a pixel's true point from viewpoint 2: in panorama 2, and in the frame of sensor 2.
  trueDirections(row, column) {
    const d = this.trueRange(row * this.panorama.columns + column);
    if (Number.isNaN(d)) return null;
    const { given, true: real } = this.facts;
    const inSensor = turned(real.R, difference(scaled(this.panorama.direction(row, column), d), real.t));
    return { panorama: turnedBack(given.R, inSensor), sensor: inSensor };
  }

  // In pixels of 2 pi / width: the error of alpha_2 that the ranges stand for.
  disparityError(method, row, column) {
    const i = row * this.panorama.columns + column;
    const angles = [
      this.curve(row, column).alphaOfRange(this.range(method, i)),
      this.curve(row, column, false).alphaOfRange(this.trueRange(i)),
    ];
    return (angles[0] - angles[1]) / this.panorama.pitch;
  }

  // How far a step of the range is in those pixels: how exact that error is.
  disparityStep(method, row, column) {
    const { alpha1, baseline } = this.curve(row, column);
    const d = this.range(method, row * this.panorama.columns + column);
    const square = d * d + baseline * baseline - 2 * d * baseline * Math.cos(alpha1);
    return (this.facts.methods[method].step * baseline * Math.sin(alpha1)) / square / this.panorama.pitch;
  }

  // The point at a range from viewpoint 1, in the world.
  point(row, column, range) {
    const { R, position } = this.facts.pose;
    return sum(position, turned(R, scaled(this.panorama.direction(row, column), range)));
  }
}
