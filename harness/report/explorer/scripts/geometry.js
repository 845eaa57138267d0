// Directions, the panorama, epipolar curves, triangulation and projection. Frames, signs and names are those of
// `harness/geometry`: vectors are in v1's orientation, angles in radians, rows go down and columns follow the azimuth.

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const scaled = (a, s) => [a[0] * s, a[1] * s, a[2] * s];
const sum = (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
const difference = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
const length = (a) => Math.hypot(a[0], a[1], a[2]);
const unit = (a) => scaled(a, 1 / length(a));
const turned = (R, a) => [dot(R.slice(0, 3), a), dot(R.slice(3, 6), a), dot(R.slice(6, 9), a)];
const turnedBack = (R, a) => [0, 1, 2].map((i) => R[i] * a[0] + R[i + 3] * a[1] + R[i + 6] * a[2]);
const modulo = (a, n) => ((a % n) + n) % n;
const wrapped = (angle) => modulo(angle + Math.PI, 2 * Math.PI) - Math.PI;
const degrees = (angle) => (angle * 180) / Math.PI;

// `every`: only every so many of the pixels, along rows and columns, is one here; angles are those of its centre.
class Panorama {
  constructor({ rows, columns, zMax, zMin }, every = 1) {
    Object.assign(this, { rows: Math.ceil(rows / every), columns: Math.ceil(columns / every), zMax, every });
    this.pitch = (2 * Math.PI) / columns;
    this.zPitch = (zMax - zMin) / rows;
  }

  phi(column) {
    return -Math.PI + (column * this.every + 0.5) * this.pitch;
  }

  z(row) {
    return this.zMax - (row * this.every + 0.5) * this.zPitch;
  }

  direction(row, column) {
    const phi = this.phi(column);
    return unit([Math.cos(phi), Math.sin(phi), this.z(row)]);
  }

  // Row and column of a direction, fractions: whole at the pixels' centres.
  pixelOf([x, y, z]) {
    const row = (this.zMax - z / Math.hypot(x, y)) / this.zPitch - 0.5;
    const column = (Math.atan2(y, x) + Math.PI) / this.pitch - 0.5;
    return [row / this.every, column / this.every];
  }
}

// The epipolar curve of a pixel of view 1, and the samples of it that are searched: `epipolar.epipolar_curves`.
class Curve {
  constructor(panorama, t, cost, row, column) {
    const x = panorama.direction(row, column);
    this.baseline = length(t);
    this.tHat = scaled(t, 1 / this.baseline);
    const along = dot(x, this.tHat);
    const across = difference(x, scaled(this.tHat, along));
    const sine = length(across);
    this.m = scaled(across, 1 / sine);
    this.n = scaled(cross(this.tHat, x), 1 / sine);
    this.alpha1 = Math.atan2(sine, along);
    this.byPhi = cost.sampling === "phi";
    this.defined = sine > 1e-9 && !(this.byPhi && Math.abs(this.n[2]) <= 1e-9);
    let near, far;
    if (this.byPhi) {
      this.start = panorama.phi(column);
      const turn = (d) => {
        if (d === null) return 0;
        const p = difference(scaled(x, d), t);
        return wrapped(Math.atan2(p[1], p[0]) - this.start);
      };
      near = turn(cost.dMin);
      far = turn(cost.dMax);
      this.step = near < 0 ? -cost.pitch : cost.pitch;
      near = Math.abs(near);
      far *= Math.sign(this.step);
    } else {
      this.start = this.alpha1;
      this.step = cost.pitch;
      near = this.alphaOfRange(cost.dMin) - this.alpha1;
      far = cost.dMax === null ? 0 : this.alphaOfRange(cost.dMax) - this.alpha1;
    }
    // The tolerance keeps a sample that lies on the end of the interval but for rounding.
    this.first = Math.ceil(far / cost.pitch - 1e-6);
    this.last = this.defined ? Math.floor(near / cost.pitch + 1e-6) : this.first - 1;
  }

  // The direction from viewpoint 2 under an angle to t.
  at(alpha) {
    return sum(scaled(this.tHat, Math.cos(alpha)), scaled(this.m, Math.sin(alpha)));
  }

  alphaOf(direction) {
    return Math.atan2(dot(direction, this.m), dot(direction, this.tHat));
  }

  // Azimuth and height on the cylinder of a sample, fractions allowed.
  pointOf(k) {
    const angle = this.start + k * this.step;
    if (this.byPhi) return [angle, -(this.n[0] * Math.cos(angle) + this.n[1] * Math.sin(angle)) / this.n[2]];
    const [x, y, z] = this.at(angle);
    return [Math.atan2(y, x), z / Math.hypot(x, y)];
  }

  alphaOfSample(k) {
    if (!this.byPhi) return this.start + k * this.step;
    const [phi, z] = this.pointOf(k);
    return this.alphaOf([Math.cos(phi), Math.sin(phi), z]);
  }

  sampleOf(alpha) {
    if (!this.byPhi) return (alpha - this.start) / this.step;
    const [x, y] = this.at(alpha);
    return wrapped(Math.atan2(y, x) - this.start) / this.step;
  }

  alphaOfRange(d) {
    return Math.atan2(d * Math.sin(this.alpha1), d * Math.cos(this.alpha1) - this.baseline);
  }

  rangeOfAlpha(alpha) {
    const apart = alpha - this.alpha1;
    return apart > 0 ? (this.baseline * Math.sin(alpha)) / Math.sin(apart) : NaN;
  }
}

// Where a sensor sees directions of its frame: cubic interpolation in the table of `projection.py`.
class Projection {
  constructor(view, table, maps, number, pixelStep) {
    Object.assign(this, { view, frame: table.frame, u: maps[`u${number}`], v: maps[`v${number}`], pixelStep });
    [this.rows, this.columns] = table.size;
    this.perTheta = (this.rows - 1) / table.thetaMax;
    this.perAzimuth = (this.columns - 1) / (2 * Math.PI);
  }

  pixel(direction) {
    const [x, y, z] = turned(this.frame, direction);
    const [i, down] = Projection.taps(Math.atan2(Math.hypot(x, y), z) * this.perTheta, this.rows);
    const [j, across] = Projection.taps((Math.atan2(y, x) + Math.PI) * this.perAzimuth, this.columns);
    let u = 0;
    let v = 0;
    for (let k = 0; k < 4; k++) {
      for (let m = 0; m < 4; m++) {
        const weight = down[k] * across[m];
        const at = (i + k) * this.columns + j + m;
        u += weight * this.u[at];
        v += weight * this.v[at];
      }
    }
    return [u * this.pixelStep, v * this.pixelStep];
  }

  static taps(position, count) {
    const first = Math.min(Math.max(Math.floor(position) - 1, 0), count - 4);
    const s = position - first;
    const [a, b, c] = [s - 1, s - 2, s - 3];
    return [first, [(-a * b * c) / 6, (s * b * c) / 2, (-s * a * c) / 2, (s * a * b) / 6]];
  }

  // The pixel of a direction that the sensor sees, or null.
  seen(direction) {
    const [lowest, highest, nearest, ux, uy, uz, ax, ay, az] = this.view.field;
    const size = length(direction);
    const sine = dot(direction, [ux, uy, uz]) / size;
    if (sine < lowest || sine > highest || dot(direction, [ax, ay, az]) / size < nearest) return null;
    const [u, v] = this.pixel(direction);
    const inside = u >= -0.5 && u <= this.view.columns - 0.5 && v >= -0.5 && v <= this.view.rows - 0.5;
    return inside ? [u, v] : null;
  }
}

// The kind of conic that the directions of a plane are seen on, from its normal in the sensor's frame: `conics.py`.
function conicOf(view, normal) {
  if (view.xi === undefined) return "";
  const z = turned(view.lens, unit(normal))[2];
  if (Math.abs(z) < 1e-9 || view.xi === 0) return "straight line";
  const other = z * z + view.xi * view.xi - 1;
  return Math.abs(other) < 1e-9 ? "parabola" : other > 0 ? "ellipse" : "hyperbola";
}
