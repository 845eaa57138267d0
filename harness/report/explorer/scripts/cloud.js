// The points in space with both viewpoints and the scene's edges, drawn pixel by pixel into a canvas with a depth for
// each pixel: a hundred thousand points take some milliseconds, and no graphics driver is needed.

class Cloud {
  // `picked` is told of the pixel of view 1 whose point was clicked at.
  constructor(element, pixels, picked) {
    Object.assign(this, { element, pixels, picked, canvas: element.querySelector("canvas"), pointers: new Map() });
    const edges = pixels.facts.edges;
    this.count = pixels.panorama.rows * pixels.panorama.columns;
    this.points = new Float32Array(3 * this.count);
    this.colours = new Uint32Array(this.count);
    const { position, second } = pixels.facts.pose;
    const corners = edges.flatMap((edge) => [edge.slice(0, 3), edge.slice(3)]);
    const seen = boundsOf([...this.ends(), position, second]);
    const whole = boundsOf([...corners, position, second]);
    // A scene that goes on far beyond what is seen is cut off.
    Object.assign(this, corners.length && whole.radius < 3 * seen.radius ? whole : seen);
    this.reset();
    this.listen();
  }

  // Two opposite corners of most of the true points.
  ends() {
    const sorted = [[], [], []];
    for (let i = 0; i < this.count; i += 97) {
      const range = this.pixels.trueRange(i);
      if (Number.isNaN(range)) continue;
      const { columns } = this.pixels.panorama;
      const point = this.pixels.point(Math.floor(i / columns), i % columns, range);
      point.forEach((each, axis) => sorted[axis].push(each));
    }
    for (const each of sorted) each.sort((a, b) => a - b);
    return [0.02, 0.98].map((share) => sorted.map((each) => each[Math.floor(share * (each.length - 1))] ?? 0));
  }

  reset() {
    Object.assign(this, { azimuth: -112, elevation: 33, zoom: 1 });
  }

  // Ranges of view 1's pixels in metres, NaN for none.
  place(rangeOf) {
    const { rows, columns } = this.pixels.panorama;
    for (let row = 0, i = 0; row < rows; row++) {
      for (let column = 0; column < columns; column++, i++) {
        const range = rangeOf(i);
        this.points.set(Number.isNaN(range) ? [NaN, NaN, NaN] : this.pixels.point(row, column, range), 3 * i);
      }
    }
  }

  colour(colourOf) {
    for (let i = 0; i < this.count; i++) this.colours[i] = colourOf(i);
  }

  // Eye, axes and scale of the picture.
  camera() {
    const [a, e] = [this.azimuth, this.elevation].map((angle) => (angle * Math.PI) / 180);
    const away = [Math.cos(e) * Math.cos(a), Math.cos(e) * Math.sin(a), Math.sin(e)];
    const right = [-Math.sin(a), Math.cos(a), 0];
    const distance = 2.6 * this.radius;
    const { width, height } = this.canvas;
    const camera = {
      eye: sum(this.centre, scaled(away, distance)),
      right,
      up: cross(away, right),
      forward: scaled(away, -1),
      scale: this.zoom * Math.min(width, 1.25 * height) * 0.5 * (distance / this.radius) * 0.8,
      middle: [0, 0],
    };
    // What is nearer is larger: the middle of the picture of the bounds is put into the middle of the canvas.
    const corners = Array.from({ length: 8 }, (_, i) => [0, 1, 2].map((axis) => ((i >> axis) & 1 ? this.high : this.low)[axis]));
    const shown = corners.map((corner) => Cloud.onto(camera, corner));
    camera.middle = [width, height].map((side, axis) => {
      const places = shown.map((place) => place[axis]);
      return (side - Math.min(...places) - Math.max(...places)) / 2;
    });
    return camera;
  }

  // Place in the canvas and distance of a point in the world.
  static onto(camera, point) {
    const p = difference(point, camera.eye);
    const depth = dot(p, camera.forward);
    const s = camera.scale / depth;
    return [camera.middle[0] + dot(p, camera.right) * s, camera.middle[1] - dot(p, camera.up) * s, depth];
  }

  // chosen: {row, column, estimate, truth} in metres, NaN for none; drawn on the next frame.
  draw(chosen = this.chosen) {
    this.chosen = chosen;
    if (this.waiting) return;
    this.waiting = true;
    requestAnimationFrame(() => {
      this.waiting = false;
      const ratio = Math.min(window.devicePixelRatio || 1, 2);
      const box = this.canvas.getBoundingClientRect();
      const [width, height] = [Math.round(box.width * ratio), Math.round(box.height * ratio)];
      if (!width) return;
      if (this.canvas.width !== width || this.canvas.height !== height) Object.assign(this.canvas, { width, height });
      this.drawPoints(ratio);
      this.drawLines(ratio);
    });
  }

  drawPoints(ratio) {
    const { width, height } = this.canvas;
    const context = this.canvas.getContext("2d");
    const camera = this.camera();
    const data = context.createImageData(width, height);
    const out = new Uint32Array(data.data.buffer);
    const depths = new Float32Array(width * height).fill(Infinity);
    this.owners = new Int32Array(width * height).fill(-1);
    const normals = this.pixels.maps.normal;
    const [r, u, f, e] = [camera.right, camera.up, camera.forward, camera.eye];
    const size = Math.round(1.8 * ratio);
    for (let i = 0; i < this.count; i++) {
      const x = this.points[3 * i] - e[0];
      const y = this.points[3 * i + 1] - e[1];
      const z = this.points[3 * i + 2] - e[2];
      // NaN fails every comparison. A surface that is seen from behind is left out: walls do not hide the room.
      if (!(x * normals[i] + y * normals[i + this.count] + z * normals[i + 2 * this.count] <= 0)) continue;
      const depth = x * f[0] + y * f[1] + z * f[2];
      if (depth < 0.02 * this.radius) continue;
      const s = camera.scale / depth;
      const column = Math.floor(camera.middle[0] + (x * r[0] + y * r[1]) * s);
      const row = Math.floor(camera.middle[1] - (x * u[0] + y * u[1] + z * u[2]) * s);
      if (column < 0 || row < 0 || column >= width - size || row >= height - size) continue;
      for (let b = 0; b < size; b++) {
        for (let at = (row + b) * width + column, a = 0; a < size; a++, at++) {
          if (depth < depths[at]) [depths[at], out[at], this.owners[at]] = [depth, this.colours[i], i];
        }
      }
    }
    context.putImageData(data, 0, 0);
  }

  drawLines(ratio) {
    const context = this.canvas.getContext("2d");
    const camera = this.camera();
    const ink = getComputedStyle(this.canvas).color;
    const { position, second } = this.pixels.facts.pose;
    const line = (a, b, width, colour, dash = []) => {
      const [from, to] = [Cloud.onto(camera, a), Cloud.onto(camera, b)];
      if (from[2] <= 0 || to[2] <= 0) return;
      Object.assign(context, { lineWidth: width * ratio, strokeStyle: colour });
      context.setLineDash(dash.map((each) => each * ratio));
      context.beginPath();
      context.moveTo(from[0], from[1]);
      context.lineTo(to[0], to[1]);
      context.stroke();
    };
    const dot = (point, radius, fill, stroke) => {
      const [x, y] = Cloud.onto(camera, point);
      Object.assign(context, { fillStyle: fill, strokeStyle: stroke, lineWidth: 1.5 * ratio });
      context.setLineDash([]);
      context.beginPath();
      context.arc(x, y, radius * ratio, 0, 2 * Math.PI);
      context.fill();
      context.stroke();
    };
    const style = getComputedStyle(this.canvas);
    context.font = `600 ${13 * ratio}px ${style.fontFamily}`;
    const label = (point, words, dx, dy) => {
      const [x, y] = Cloud.onto(camera, point).map((each, i) => each + [dx, dy, 0][i] * ratio);
      const width = context.measureText(words).width;
      context.fillStyle = style.backgroundColor;
      context.fillRect(x - 2 * ratio, y - 12 * ratio, width + 4 * ratio, 16 * ratio);
      context.fillStyle = ink;
      context.fillText(words, x, y);
    };
    context.globalAlpha = 0.5;
    for (const edge of this.pixels.facts.edges) line(edge.slice(0, 3), edge.slice(3), 0.9, ink);
    context.globalAlpha = 1;
    const size = 10 ** Math.floor(Math.log10(this.radius));
    ["x", "y", "z"].forEach((name, axis) => {
      const end = this.low.map((each, i) => each + (i === axis ? size : 0));
      line(this.low, end, 2, ink);
      label(end, axis ? name : `${name}, ${size} m`, 5, axis === 2 ? -5 : 12);
    });
    const { row, column, estimate, truth, colour } = this.chosen;
    const [found, real] = [estimate, truth].map((range) => (Number.isNaN(range) ? null : this.pixels.point(row, column, range)));
    line(position, second, 2, ink);
    for (const view of [position, second]) {
      if (real) line(view, real, 1, ink, [4, 3]);
      if (found) line(view, found, 1.5, colour);
      dot(view, 4.5, "#fff", "#000");
    }
    if (found) dot(found, 4, colour, "#fff");
    if (real) dot(real, 2.5, "#fff", "#000");
    label(position, "v₁", -24, -4);
    label(second, "v₂", 9, -4);
  }

  turn(azimuth, elevation, zoom = 1) {
    this.azimuth += azimuth;
    this.elevation = Math.min(Math.max(this.elevation + elevation, -89), 89);
    this.zoom = Math.min(Math.max(this.zoom * zoom, 0.3), 12);
    this.draw();
  }

  listen() {
    const { canvas, element, pointers } = this;
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      pointers.set(event.pointerId, [event.clientX, event.clientY]);
      this.still = pointers.size === 1;
    });
    canvas.addEventListener("pointermove", (event) => {
      const before = pointers.get(event.pointerId);
      if (!before) return;
      const now = [event.clientX, event.clientY];
      const other = [...pointers].find(([id]) => id !== event.pointerId)?.[1];
      if (Math.hypot(now[0] - before[0], now[1] - before[1]) < 3 && this.still) return;
      this.still = false;
      pointers.set(event.pointerId, now);
      const apart = (a) => Math.hypot(a[0] - other[0], a[1] - other[1]);
      if (other) this.turn(0, 0, apart(now) / Math.max(apart(before), 1));
      else this.turn((before[0] - now[0]) * 0.4, (now[1] - before[1]) * 0.4);
    });
    for (const name of ["pointerup", "pointercancel"]) {
      canvas.addEventListener(name, (event) => {
        if (name === "pointerup" && this.still) this.pick(event);
        pointers.delete(event.pointerId);
        this.still = false;
      });
    }
    canvas.addEventListener("wheel", (event) => {
      if (!event.ctrlKey) return; // a wheel alone scrolls the page
      event.preventDefault();
      this.turn(0, 0, Math.exp(-event.deltaY / 300));
    }, { passive: false });
    const moves = {
      ArrowLeft: [5, 0], ArrowRight: [-5, 0], ArrowUp: [0, 5], ArrowDown: [0, -5], "+": [0, 0, 1.2], "-": [0, 0, 1 / 1.2],
    };
    canvas.addEventListener("keydown", (event) => {
      if (!moves[event.key] || event.ctrlKey || event.metaKey || event.altKey) return;
      event.preventDefault();
      this.turn(...moves[event.key]);
    });
    for (const button of element.querySelectorAll("button")) {
      button.addEventListener("click", () => {
        if (button.value === "reset") this.reset();
        this.turn(...(moves[button.value] ?? [0, 0]));
      });
    }
  }

  // The pixel whose point is drawn where the pointer is, or next to it.
  pick(event) {
    const box = this.canvas.getBoundingClientRect();
    const ratio = this.canvas.width / box.width;
    const [x, y] = [event.clientX - box.left, event.clientY - box.top].map((each) => Math.floor(each * ratio));
    const { columns } = this.pixels.panorama;
    for (let reach = 0; reach <= 6; reach++) {
      for (let b = y - reach; b <= y + reach; b++) {
        for (let a = x - reach; a <= x + reach; a++) {
          const owner = this.owners?.[b * this.canvas.width + a] ?? -1;
          if (a >= 0 && a < this.canvas.width && owner >= 0) return this.picked(Math.floor(owner / columns), owner % columns);
        }
      }
    }
  }
}

// The lowest corner of points, their middle, and half their diagonal.
function boundsOf(points) {
  const [low, high] = [Math.min, Math.max].map((most) =>
    [0, 1, 2].map((axis) => points.reduce((value, point) => most(value, point[axis]), points[0][axis])),
  );
  return { low, high, centre: scaled(sum(low, high), 0.5), radius: length(difference(high, low)) / 2 || 1 };
}
