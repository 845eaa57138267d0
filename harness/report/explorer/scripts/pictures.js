// The pictures: a panorama or a mirror image on a canvas, and marks on it in SVG, whose lines and dots keep their size.

const SVG = "http://www.w3.org/2000/svg";

class Picture {
  // width, height: in the picture's own pixels, which the marks are in too. `listens` is told of what is pointed at.
  constructor(element, width, height, listens) {
    Object.assign(this, { element, width, height, listens, pressed: false });
    this.canvas = element.querySelector("canvas");
    this.svg = element.querySelector("svg");
    this.svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
    element.style.aspectRatio = `${width} / ${height}`;
    element.addEventListener("pointerdown", (event) => {
      this.pressed = true;
      listens.pressed(this.place(event), event.pointerType);
    });
    element.addEventListener("pointermove", (event) => {
      if (event.pointerType === "mouse") listens.over(this.place(event));
      else if (this.pressed) listens.pressed(this.place(event), event.pointerType);
    });
    for (const name of ["pointerup", "pointercancel"]) {
      element.addEventListener(name, () => {
        this.pressed = false;
      });
    }
    element.addEventListener("keydown", (event) => {
      const step = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
      if (!step || event.ctrlKey || event.metaKey || event.altKey) return;
      event.preventDefault();
      listens.moved(...step.map((each) => each * (event.shiftKey ? 10 : 1)));
    });
  }

  // Where an event is, in pixels from the upper left corner.
  place(event) {
    const box = this.svg.getBoundingClientRect();
    return [((event.clientX - box.left) / box.width) * this.width, ((event.clientY - box.top) / box.height) * this.height];
  }

  // Colour all pixels: `colour` of a place in the picture, as ImageData holds it.
  paint(columns, rows, colour) {
    Object.assign(this.canvas, { width: columns, height: rows });
    const context = this.canvas.getContext("2d");
    const data = context.createImageData(columns, rows);
    const pixels = new Uint32Array(data.data.buffer);
    for (let y = 0; y < rows; y++) for (let x = 0; x < columns; x++) pixels[y * columns + x] = colour(x, y);
    context.putImageData(data, 0, 0);
  }

  // Draw lines and dots anew: [class, points, colour], a line where there are several points, and null breaks it.
  mark(marks) {
    const drawn = marks.map(([name, points, colour]) => {
      const path = document.createElementNS(SVG, "path");
      path.setAttribute("class", name);
      path.setAttribute("d", points.length > 1 ? pathOf(points) : points[0] ? `M${points[0].map(short)}h0` : "");
      if (colour) path.style.stroke = colour;
      return path;
    });
    this.svg.replaceChildren(...drawn);
  }
}

const short = (value) => value.toFixed(2);

function pathOf(points) {
  let path = "";
  let pen = false;
  for (const point of points) {
    if (point) path += `${pen ? "L" : "M"}${point.map(short)}`;
    pen = Boolean(point);
  }
  return path;
}

// Points of a line, with a break where two neighbours are more than `jump` apart: at a seam.
function broken(points, jump) {
  return points.flatMap((point, i) => {
    const before = points[i - 1];
    return point && before && Math.hypot(point[0] - before[0], point[1] - before[1]) > jump ? [null, point] : [point];
  });
}
