// What a panorama is coloured by: each layer says its colour for a pixel, and what its colours mean.

const OCCLUSION = [
  ["seen by both views", "#E8EEF3"],
  ["seen by both, within 30° of the baseline", "#9DB4C0"],
  ["hidden from view 2", "#D55E00"],
  ["outside view 2’s field", "#56B4E9"],
  ["nothing there", "#000000"],
];
const NO_VALUE = "#C9C9C9";

// A colour as ImageData holds it.
function packedColour(hex) {
  const [r, g, b] = [1, 3, 5].map((i) => parseInt(hex.slice(i, i + 2), 16));
  return (255 << 24) | (b << 16) | (g << 8) | r;
}

function scaleLayer(title, unit, scale, value, digits) {
  const colours = scale.colours.map(packedColour);
  const none = packedColour(NO_VALUE);
  return {
    title,
    colour(i) {
      const share = (value(i) - scale.low) / (scale.high - scale.low);
      if (Number.isNaN(share)) return none;
      return colours[Math.min(Math.max(Math.floor(share * colours.length), 0), colours.length - 1)];
    },
    legend: { unit, ...scale, digits },
  };
}

// classes: [number, [name, colour]] of each class.
function classLayer(title, classes, classOf) {
  const colours = new Map(classes.map(([key, [, hex]]) => [key, packedColour(hex)]));
  return { title, colour: (i) => colours.get(classOf(i)), classes, classOf };
}

// All layers of a method, by name.
function layersOf(pixels, method, picture) {
  const { scales, reasons } = pixels.facts;
  const digits = scales.range.high - scales.range.low < 2 ? 2 : 1;
  return {
    picture: {
      title: "Picture",
      colour: (i) => (255 << 24) | (picture[i] * 0x010101),
      legend: { unit: "grey level", low: 0, high: 255, colours: ["#000000", "#ffffff"], digits: 0 },
    },
    error: scaleLayer("Range error", "mm", scales.error, (i) => 1000 * pixels.error(method, i), 0),
    range: scaleLayer("Range", "m", scales.range, (i) => pixels.range(method, i), digits),
    trueRange: scaleLayer("True range", "m", scales.range, (i) => pixels.trueRange(i), digits),
    sigma: scaleLayer("σ of the range, predicted", "mm", scales.sigma, (i) => 1000 * pixels.sigma(method, i), 0),
    reason: classLayer("Reason for having no range", reasons, (i) => pixels.reason(method, i)),
    occlusion: classLayer("Occlusion", [...OCCLUSION.entries()], (i) => pixels.occlusion(i)),
  };
}

// Grey levels 0 .. 255 of a view unwrapped on the panorama, for looking at: between pixels linear.
function unwrapped(pixels, number, image) {
  const { rows, columns } = pixels.panorama;
  const projection = pixels.projections[number];
  const { smaller } = projection.view;
  const [height, width] = pixels.facts.arrays[`image${number}`];
  const grey = new Uint8Array(rows * columns);
  for (let row = 0; row < rows; row++) {
    for (let column = 0; column < columns; column++) {
      let direction = pixels.panorama.direction(row, column);
      if (number === 1) direction = turned(pixels.facts.given.R, direction);
      const pixel = projection.seen(direction);
      if (!pixel) continue;
      const [x, y] = pixel.map((each) => (each + 0.5) / smaller - 0.5);
      const j = Math.min(Math.max(Math.floor(x), 0), width - 2);
      const i = Math.min(Math.max(Math.floor(y), 0), height - 2);
      const [f, g, at] = [x - j, y - i, i * width + j];
      const upper = image[at] * (1 - f) + image[at + 1] * f;
      const lower = image[at + width] * (1 - f) + image[at + width + 1] * f;
      grey[row * columns + column] = pixels.steps.shade * (upper * (1 - g) + lower * g);
    }
  }
  return grey;
}

// A legend as HTML, of the classes that some of the pixels have.
function legendOf(layer, count) {
  const parts = [];
  if (layer.legend) {
    const { unit, low, high, colours, digits } = layer.legend;
    const ticks = [low, (low + high) / 2, high].map((value) => `<span>${fixed(value, digits)}</span>`).join("");
    const bar = `<span class="explorer-scale" style="background:linear-gradient(to right,${colours.join()})"></span>`;
    parts.push(`<span class="explorer-ticks">${bar}<span>${ticks}</span></span><span>${layer.title} (${unit})</span>`);
    if (layer.title !== "Picture") parts.push(swatch("no value", NO_VALUE));
  } else {
    const shares = new Map();
    for (let i = 0; i < count; i++) shares.set(layer.classOf(i), (shares.get(layer.classOf(i)) ?? 0) + 100 / count);
    for (const [key, [name, colour]] of layer.classes) {
      if (shares.has(key)) parts.push(swatch(`${name} (${fixed(shares.get(key), 1)} %)`, colour));
    }
  }
  return parts.join(" ");
}

const swatch = (name, colour) => `<span class="explorer-swatch" style="--key:${colour}">${name}</span>`;

// A number with a true minus sign, and none before zero.
function fixed(value, digits) {
  const text = value.toFixed(digits);
  return (/[1-9]/.test(text) ? text : text.replace("-", "")).replace("-", "−");
}
