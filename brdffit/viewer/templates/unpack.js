// What brdffit/viewer/packing.py packed, back to numbers.

async function inflate(text) {
  const letters = atob(text), bytes = new Uint8Array(letters.length);
  for (let i = 0; i < bytes.length; i++) bytes[i] = letters.charCodeAt(i);
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

// A plane of differences along rows: bytes, or 16-bit integers whose low bytes come first.
function plane(bytes, start, width, height, wide) {
  const count = width * height;
  const out = wide ? new Int16Array(count) : new Uint8Array(count);
  for (let y = 0, i = 0; y < height; y++)
    for (let x = 0, last = 0; x < width; x++, i++) {
      const low = last + bytes[start + i];
      last = wide ? (low + (bytes[start + count + i] << 8)) & 65535 : low & 255;
      out[i] = last;
    }
  return out;
}

// Normals (x, y, z, 0) of their x and y.
function normals(xs, ys) {
  const out = new Float32Array(4 * xs.length);
  for (let i = 0; i < xs.length; i++) {
    const x = xs[i] / 2047, y = ys[i] / 2047;
    out[4 * i] = x;
    out[4 * i + 1] = y;
    out[4 * i + 2] = Math.sqrt(Math.max(1 - x * x - y * y, 0));
  }
  return out;
}

// Sigma (XX, YY, XY, 0) times TENSOR_SCALE: the exponential of log Sigma, of which mean and half the difference of the
// diagonal are given, and what is beside it.
function tensors(means, halves, offs) {
  const out = new Float32Array(4 * means.length);
  for (let i = 0; i < means.length; i++) {
    const mean = means[i] / 256, half = halves[i] / 256, off = offs[i] / 256;
    const radius = Math.sqrt(half * half + off * off);
    const larger = 0.5 * TENSOR_SCALE * Math.exp(mean + radius), smaller = 0.5 * TENSOR_SCALE * Math.exp(mean - radius);
    const middle = larger + smaller, slope = radius > 0 ? (larger - smaller) / radius : 0;
    out[4 * i] = middle + slope * half;
    out[4 * i + 1] = middle - slope * half;
    out[4 * i + 2] = slope * off;
  }
  return out;
}

// Pixels of four bytes; where there are three planes, the fourth is 255.
function interleaved(planes) {
  const out = new Uint8Array(4 * planes[0].length).fill(255);
  planes.forEach((values, k) => {
    for (let i = 0; i < values.length; i++) out[4 * i + k] = values[i];
  });
  return out;
}

// Levels of a record: arrays to upload, one entry a level.
async function unpackLevels(record) {
  const [shapes, colours] = await Promise.all([inflate(record.shapes), inflate(record.colours)]);
  let shape = 0, colour = 0;
  return record.sizes.map(([height, width]) => {
    const count = width * height;
    const integers = () => plane(shapes, (shape += 2 * count) - 2 * count, width, height, true);
    const bytes = () => plane(colours, (colour += count) - count, width, height, false);
    return {
      width,
      height,
      normal: normals(integers(), integers()),
      tensor: tensors(integers(), integers(), integers()),
      specular: interleaved([bytes(), bytes(), bytes(), bytes()]),
      diffuse: interleaved([bytes(), bytes(), bytes()]),
    };
  });
}

// An environment: colours over a shared exponent, as floats.
async function unpackEnvironment(record) {
  const [height, width] = record.size, count = width * height;
  const bytes = await inflate(record.data);
  const planes = [0, 1, 2, 3].map(k => plane(bytes, k * count, width, height, false));
  const pixels = new Float32Array(4 * count);
  for (let i = 0; i < count; i++) {
    const step = 2 ** (planes[3][i] - 128) / 255;
    for (let k = 0; k < 3; k++) pixels[4 * i + k] = planes[k][i] * step;
  }
  return {width, height, pixels};
}
