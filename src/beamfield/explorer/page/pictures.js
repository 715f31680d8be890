// Canvases and pictures.

export const CAUSES = ["hit", "short", "max", "rand"];
const NAMES = ["wall", "free", "unknown", "ink", "quiet", "line", "panel", "accent", "heat", "belief", ...CAUSES];

export function coloursOf(root) {
  const style = getComputedStyle(root);
  return Object.fromEntries(NAMES.map((name) => [name, style.getPropertyValue(`--${name}`).trim()]));
}

// A canvas whose pixels are those of the screen; returns a context that counts in CSS pixels.
export function sharp(canvas, options = {}) {
  const ratio = globalThis.devicePixelRatio || 1, width = Math.round(canvas.clientWidth * ratio), height = Math.round(canvas.clientHeight * ratio);
  if (canvas.width !== width || canvas.height !== height) { canvas.width = width; canvas.height = height; }
  const context = canvas.getContext("2d", options);
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  return context;
}

function rgb(colour) {
  const context = new OffscreenCanvas(1, 1).getContext("2d");
  context.fillStyle = colour;
  context.fillRect(0, 0, 1, 1);
  return [...context.getImageData(0, 0, 1, 1).data];
}

// The map's picture, white where free and black where occupied, in the colours of the page.
export async function recoloured(base64, colours) {
  const image = new Image();
  image.src = `data:image/png;base64,${base64}`;
  await image.decode();
  const canvas = new OffscreenCanvas(image.width, image.height), context = canvas.getContext("2d");
  context.drawImage(image, 0, 0);
  const pixels = context.getImageData(0, 0, image.width, image.height), wall = rgb(colours.wall), free = rgb(colours.free);
  for (let k = 0; k < pixels.data.length; k += 4) {
    if (pixels.data[k + 3] > 0) pixels.data.set((pixels.data[k] < 128 ? wall : free).slice(0, 3), k);
  }
  context.putImageData(pixels, 0, 0);
  return canvas;
}

// Bytes, the lowest row first, as an image that is the denser the larger they are.
export function shaded({ heat, rows, cols }, colour) {
  const bytes = atob(heat), canvas = new OffscreenCanvas(cols, rows), context = canvas.getContext("2d"), [r, g, b] = rgb(colour);
  const pixels = context.createImageData(cols, rows);
  for (let row = 0; row < rows; row++) {
    for (let col = 0; col < cols; col++) {
      pixels.data.set([r, g, b, 0.9 * bytes.charCodeAt(row * cols + col)], 4 * ((rows - 1 - row) * cols + col));
    }
  }
  context.putImageData(pixels, 0, 0);
  return canvas;
}

export function download(name, text) {
  const link = document.createElement("a");
  Object.assign(link, { href: URL.createObjectURL(new Blob([text], { type: "text/plain" })), download: name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
}
