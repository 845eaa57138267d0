// Reads the maps that `arrays.py` has packed: differences along rows and columns, in planes of bytes, deflated, as base64.

async function unpacked(text, [rows, columns, planes]) {
  const packed = atob(text);
  const bytes = new Uint8Array(packed.length);
  for (let i = 0; i < packed.length; i++) bytes[i] = packed.charCodeAt(i);
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  const data = new Uint8Array(await new Response(stream).arrayBuffer());
  const size = rows * columns;
  const values = new Int32Array(size);
  for (let plane = 0; plane < planes; plane++) {
    for (let i = 0; i < size; i++) values[i] |= data[plane * size + i] << (8 * plane);
  }
  for (let row = 0, i = 0; row < rows; row++) {
    for (let column = 0, sum = 0; column < columns; column++, i++) {
      sum = (sum + ((values[i] >>> 1) ^ -(values[i] & 1))) | 0; // 0, 1, 2, 3 ... stand for 0, -1, 1, -2 ...
      values[i] = row ? (values[i - columns] + sum) | 0 : sum;
    }
  }
  return values;
}

// All maps by name. What they were read from is let go.
async function mapsIn(root, shapes) {
  const maps = {};
  for (const element of root.querySelectorAll("[data-map]")) {
    const name = element.dataset.map;
    maps[name] = await unpacked(element.dataset.packed, shapes[name]);
    element.remove();
  }
  return maps;
}
