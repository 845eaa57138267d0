// Which pixel of view 1 is seen nearest to a place in a picture, by cells of one pixel of the picture.

class Nearest {
  // placeOf(row, column): where a pixel of view 1 is in the picture, or null.
  constructor(width, height, panorama, placeOf) {
    Object.assign(this, { width, height, panorama, placeOf });
    this.cells = new Int32Array(width * height).fill(-1);
    const apart = new Float32Array(width * height).fill(Infinity);
    for (let row = 0; row < panorama.rows; row++) {
      for (let column = 0; column < panorama.columns; column++) {
        const place = placeOf(row, column);
        if (!place) continue;
        const [j, i] = place.map(Math.floor);
        if (j < 0 || i < 0 || j >= width || i >= height) continue;
        const distance = Math.hypot(place[0] - j - 0.5, place[1] - i - 0.5);
        if (distance < apart[i * width + j]) {
          apart[i * width + j] = distance;
          this.cells[i * width + j] = row * panorama.columns + column;
        }
      }
    }
  }

  // [row, column] of the nearest within a few pixels, or null.
  at([x, y], within = 4) {
    const [j, i] = [Math.floor(x), Math.floor(y)];
    let best = null;
    let least = within;
    const consider = (row, column) => {
      const place = this.placeOf(row, column);
      const distance = place ? Math.hypot(place[0] - x, place[1] - y) : Infinity;
      if (distance < least) [best, least] = [[row, column], distance];
      return distance;
    };
    for (let b = Math.max(0, i - within); b <= Math.min(this.height - 1, i + within); b++) {
      for (let a = Math.max(0, j - within); a <= Math.min(this.width - 1, j + within); a++) {
        const pixel = this.cells[b * this.width + a];
        if (pixel >= 0) consider(Math.floor(pixel / this.panorama.columns), pixel % this.panorama.columns);
      }
    }
    // A cell knows one of its pixels only: its neighbours may be nearer.
    for (let from = null; best && from !== best; ) {
      from = best;
      for (const down of [-1, 0, 1]) {
        for (const across of [-1, 0, 1]) {
          const row = from[0] + down;
          if (row >= 0 && row < this.panorama.rows) consider(row, modulo(from[1] + across, this.panorama.columns));
        }
      }
    }
    return best;
  }
}
