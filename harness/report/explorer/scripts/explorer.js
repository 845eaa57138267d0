// The explorer: one pixel of view 1 is chosen, and every part shows what is known of it.

class Explorer {
  constructor(root, facts, maps) {
    Object.assign(this, { root, facts, maps, pixels: new Pixels(facts, maps), held: false, layer: "error", method: 0 });
    this.panorama = this.pixels.panorama;
    this.costs = new Costs(facts, maps);
    this.pictures = [0, 1].map((view) => unwrapped(this.pixels, view, maps[`image${view}`]));
    this.makePictures();
    this.chart = new Chart(root.querySelector("[data-part=chart]"), facts);
    this.cloud = new Cloud(root.querySelector("[data-part=cloud]"), this.pixels, (row, column) => this.choose(row, column, true));
    for (const name of ["method", "layer"]) {
      for (const input of root.querySelectorAll(`input[name=explorer-${name}]`)) {
        input.addEventListener("change", () => this.show({ [name]: name === "method" ? Number(input.value) : input.value }));
        if (input.checked) this[name] = name === "method" ? Number(input.value) : input.value;
      }
    }
    for (const button of root.querySelectorAll("[data-move]")) {
      button.addEventListener("click", () => this.move(...button.dataset.move.split(",").map(Number)));
    }
    root.querySelector("[data-part=hold]").addEventListener("click", () => this.hold(!this.held));
    root.addEventListener("keydown", (event) => event.key === "Escape" && this.hold(false));
    [this.row, this.column] = facts.start.map((each) => Math.floor(each / facts.every));
    this.show({});
    new ResizeObserver(() => this.draw()).observe(root);
  }

  // --- The pictures and what is pointed at in them ---

  makePictures() {
    const { rows, columns } = this.panorama;
    const place = ([row, column]) => [columns - 0.5 - column, row + 0.5]; // as seen from inside: azimuth descends
    const views = this.facts.views;
    this.places = {
      panorama0: (row, column) => place([row, column]),
      panorama1: (row, column) => {
        const towards = this.visible(row, column) ? this.pixels.trueDirections(row, column) : null;
        return towards && place(this.panorama.pixelOf(towards.panorama));
      },
      image0: (row, column) => this.onImage(0, this.panorama.direction(row, column)),
      image1: (row, column) => {
        const towards = this.visible(row, column) ? this.pixels.trueDirections(row, column) : null;
        return towards && this.onImage(1, towards.sensor);
      },
    };
    const sizes = { panorama0: [columns, rows], panorama1: [columns, rows] };
    views.forEach((view, i) => {
      sizes[`image${i}`] = [view.columns, view.rows];
    });
    this.parts = {};
    this.nearest = {};
    for (const [name, [width, height]] of Object.entries(sizes)) {
      const listens = {
        over: (at) => this.held || this.pointAt(name, at),
        pressed: (at, kind) => {
          if (kind === "mouse") this.hold(!this.held);
          this.pointAt(name, at);
        },
        moved: (dx, dy) => this.moveIn(name, dx, dy),
      };
      this.parts[name] = new Picture(this.root.querySelector(`[data-picture=${name}]`), width, height, listens);
    }
    const grey = (level) => (255 << 24) | (Math.round(level) * 0x010101);
    this.parts.panorama1.paint(columns, rows, (x, y) => grey(this.pictures[1][y * columns + columns - 1 - x]));
    views.forEach((view, i) => {
      const [height, width] = this.facts.arrays[`image${i}`];
      const [image, shade] = [this.maps[`image${i}`], this.facts.steps.shade];
      this.parts[`image${i}`].paint(width, height, (x, y) => grey(shade * image[y * width + x]));
    });
  }

  visible(row, column) {
    return (this.maps.seen[row * this.panorama.columns + column] & VISIBLE) === VISIBLE;
  }

  // Where view `number` sees a direction of its frame, in the picture: pixel (0, 0) has its centre at (0.5, 0.5).
  onImage(number, direction) {
    const pixel = this.pixels.projections[number].seen(direction);
    return pixel && [pixel[0] + 0.5, pixel[1] + 0.5];
  }

  pointAt(name, [x, y]) {
    const { rows, columns } = this.panorama;
    if (name === "panorama0") {
      const [row, column] = [Math.floor(y), columns - 1 - Math.floor(x)];
      if (row >= 0 && row < rows && column >= 0 && column < columns) this.choose(row, column);
      return;
    }
    const { width, height } = this.parts[name];
    this.nearest[name] ??= new Nearest(width, height, this.panorama, this.places[name]);
    const found = this.nearest[name].at([x, y]);
    if (found) this.choose(...found);
    else this.say(name === "image0" ? "Outside the panorama." : "View 1 sees nothing of what is here.");
  }

  // Move in a picture by some of its pixels, at least to the next pixel of view 1.
  moveIn(name, dx, dy) {
    if (name === "panorama0") return this.move(dy, -dx);
    const from = this.places[name](this.row, this.column);
    if (!from) return this.move(dy, -dx);
    const before = [this.row, this.column];
    for (let steps = 1; steps <= 8 && this.row === before[0] && this.column === before[1]; steps++) {
      this.pointAt(name, [from[0] + steps * dx, from[1] + steps * dy]);
    }
    this.announce();
  }

  move(down, right) {
    const row = Math.min(Math.max(this.row + down, 0), this.panorama.rows - 1);
    this.choose(row, modulo(this.column + right, this.panorama.columns));
    this.announce();
  }

  hold(held) {
    this.held = held;
    const button = this.root.querySelector("[data-part=hold]");
    button.setAttribute("aria-pressed", String(held));
    button.textContent = held ? "Held: release" : "Hold this pixel";
  }

  choose(row, column, announce = false) {
    Object.assign(this, { row, column });
    this.say("");
    this.draw();
    if (announce) this.announce();
  }

  // --- What is shown ---

  // Change the method or the layer.
  show(changes) {
    Object.assign(this, changes);
    const { columns } = this.panorama;
    const layers = layersOf(this.pixels, this.method, this.pictures[0]);
    const layer = layers[this.layer];
    this.parts.panorama0.paint(columns, this.panorama.rows, (x, y) => layer.colour(y * columns + columns - 1 - x));
    this.root.querySelector("[data-part=legend]").innerHTML = legendOf(layer, this.panorama.rows * columns);
    this.cloud.place((i) => this.pixels.range(this.method, i));
    this.cloud.colour(layer.colour);
    this.draw();
  }

  draw() {
    const { row, column } = this;
    const curve = this.pixels.curve(row, column);
    this.mark(curve);
    const numbers = this.numbers(row, column);
    this.fill(numbers, curve);
    const found = this.facts.methods.map((_, method) => this.sampleOf(curve, this.range(method)));
    const marks = this.facts.methods.map((method, i) => ({ ...method, k: found[i], chosen: i === this.method }));
    const towards = this.pixels.trueDirections(row, column);
    const truth = towards && curve.defined ? curve.sampleOf(curve.alphaOf(towards.panorama)) : null;
    this.chart.draw(curve, numbers.costs, marks.filter((mark) => mark.k !== null), truth);
    const i = row * this.panorama.columns + column;
    const { colour } = this.facts.methods[this.method];
    this.cloud.draw({ row, column, colour, estimate: this.range(this.method), truth: this.pixels.trueRange(i) });
  }

  range(method) {
    return this.pixels.range(method, this.row * this.panorama.columns + this.column);
  }

  sampleOf(curve, range) {
    return Number.isNaN(range) || !curve.defined ? null : curve.sampleOf(curve.alphaOfRange(range));
  }

  // The numbers of a pixel of the panorama, as they are shown; metres and pixels, NaN for none.
  at(row, column) {
    return this.numbers(Math.floor(row / this.facts.every), Math.floor(column / this.facts.every));
  }

  numbers(row, column) {
    const i = row * this.panorama.columns + column;
    const methods = this.facts.methods.map(({ key }, method) => ({
      key,
      range: this.pixels.range(method, i),
      error: this.pixels.error(method, i),
      disparity: this.pixels.disparityError(method, row, column),
      sigma: this.pixels.sigma(method, i),
      reason: this.pixels.reason(method, i),
    }));
    const curve = this.pixels.curve(row, column);
    const [ownRow, ownColumn] = [row, column].map((each) => each * this.facts.every);
    return {
      row: ownRow,
      column: ownColumn,
      methods,
      alpha1: curve.alpha1,
      trueRange: this.pixels.trueRange(i),
      occlusion: this.pixels.occlusion(i),
      surface: this.pixels.surface(i),
      first: curve.first,
      costs: this.costs.along(curve, ownRow, ownColumn),
      pixels: [0, 1].map((view) => this.places[`image${view}`](row, column)?.map((each) => each - 0.5) ?? null),
    };
  }

  mark(curve) {
    const { columns } = this.panorama;
    const onPanorama = (direction) => {
      const [row, column] = this.panorama.pixelOf(direction);
      return row > -1 && row < this.panorama.rows ? [columns - 0.5 - column, row + 0.5] : null;
    };
    const R = this.facts.given.R;
    const places = {
      panorama0: onPanorama,
      panorama1: onPanorama,
      image0: (direction) => this.onImage(0, direction),
      image1: (direction) => this.onImage(1, turned(R, direction)),
    };
    const turn = Array.from({ length: 721 }, (_, i) => curve.at(((i - 360) * Math.PI) / 360));
    const [from, to] = [curve.first, curve.last].map((k) => curve.alphaOfSample(k));
    const searched = Array.from({ length: 81 }, (_, i) => curve.at(from + ((to - from) * i) / 80));
    const towards = this.pixels.trueDirections(this.row, this.column);
    for (const [name, placed] of Object.entries(places)) {
      const jump = this.parts[name].width / 4;
      const marks = [];
      const add = (style, points, colour) => marks.push([`casing ${style}`, points], [style, points, colour]);
      if (curve.defined) add("curve", broken(turn.map(placed), jump));
      if (name.endsWith("0")) {
        const own = placed(this.panorama.direction(this.row, this.column));
        add("own", own ? [own] : []);
      } else {
        if (curve.last >= curve.first) add("searched", broken(searched.map(placed), jump));
        const real = towards && (name === "image1" ? this.onImage(1, towards.sensor) : onPanorama(towards.panorama));
        add("truth", real ? [real] : []);
        this.facts.methods.forEach(({ colour }, method) => {
          const range = this.range(method);
          const point = Number.isNaN(range) ? null : placed(curve.at(curve.alphaOfRange(range)));
          add(method === this.method ? "found chosen" : "found", point ? [point] : [], colour);
        });
      }
      this.parts[name].mark(marks);
    }
  }

  fill(numbers, curve) {
    const set = (name, text) => {
      this.root.querySelector(`[data-part=${name}]`).textContent = text;
    };
    const phi = degrees(this.panorama.phi(this.column));
    const elevation = degrees(Math.atan(this.panorama.z(this.row)));
    set("pixel", `Row ${numbers.row}, column ${numbers.column}`);
    set("direction", `azimuth ${fixed(phi, 1)}°, elevation ${fixed(elevation, 1)}°, α₁ = ${fixed(degrees(numbers.alpha1), 1)}°`);
    set("surface", `${numbers.surface}; ${OCCLUSION[numbers.occlusion][0]}`);
    const kinds = [curve.n, turned(this.facts.given.R, curve.n)].map((normal, view) => conicOf(this.facts.views[view], normal));
    const curves = [0, 1].map((view) => `${kinds[view] || "not a conic"}`);
    set("conic", curves[0] === curves[1] ? curves[0] : `${curves[0]} in view 1, ${curves[1]} in view 2`);
    const shown = (value, digits, scale = 1) => (Number.isNaN(value) ? "–" : fixed(scale * value, digits));
    // As many as a step shows in.
    const decimals = (step) => Math.min(Math.max(Math.floor(1e-6 - Math.log10(step)), 0), 6);
    set("true-range", shown(numbers.trueRange, decimals(this.facts.steps.trueRange)));
    numbers.methods.forEach((method, i) => {
      const digits = decimals(this.facts.methods[i].step);
      set(`range-${i}`, shown(method.range, digits));
      set(`error-${i}`, shown(method.error, Math.max(digits - 3, 0), 1000));
      const exact = this.pixels.disparityStep(i, this.row, this.column);
      set(`disparity-${i}`, shown(method.disparity, Number.isNaN(exact) ? 0 : Math.min(decimals(exact), 3)));
      set(`sigma-${i}`, Number.isNaN(method.sigma) ? "–" : `${Number((1000 * method.sigma).toPrecision(2))}`);
      set(`reason-${i}`, this.reasons(method.reason));
    });
  }

  reasons(reason) {
    return this.facts.reasons.find(([code]) => code === reason)[1][0];
  }

  say(words) {
    this.root.querySelector("[data-part=hint]").textContent = words;
  }

  // To those who listen: when keys have come to rest.
  announce() {
    clearTimeout(this.waiting);
    this.waiting = setTimeout(() => {
      const { row, column, trueRange, methods } = this.numbers(this.row, this.column);
      const chosen = methods[this.method];
      const words = Number.isNaN(chosen.range)
        ? `no range: ${this.reasons(chosen.reason)}`
        : `range ${fixed(chosen.range, 3)} metres, error ${fixed(1000 * chosen.error, 1)} millimetres`;
      const real = Number.isNaN(trueRange) ? "" : `, true range ${fixed(trueRange, 3)} metres`;
      this.root.querySelector("[data-part=spoken]").textContent = `Row ${row}, column ${column}: ${words}${real}.`;
    }, 400);
  }
}

// Begins when the reader comes near: until then the page is as quick as without it.
function beginExplorer() {
  const root = document.getElementById("explorer-app");
  if (!root) return;
  const note = document.getElementById("explorer-note");
  const begin = async () => {
    try {
      const facts = JSON.parse(root.dataset.facts);
      root.explorer = new Explorer(root, facts, await mapsIn(root, facts.arrays));
      root.classList.add("ready");
    } catch (error) {
      root.hidden = true;
      note.classList.remove("replaced");
      note.textContent = `The explorer could not be shown by this browser: ${error.message}`;
    }
  };
  root.hidden = false;
  note.classList.add("replaced"); // it stays on paper
  const nearby = new IntersectionObserver((entries) => {
    if (!entries.some((entry) => entry.isIntersecting)) return;
    nearby.disconnect();
    begin();
  }, { rootMargin: "800px" });
  nearby.observe(root);
}

beginExplorer();
