// Colours of pixels and of what is drawn over them. Orange and cyan are told apart by all eyes, and both from grey.

export const CONTOUR = "#ff9a1f";
export const CENTRE = "#22e3ff";
export const SATURATED: [number, number, number] = [255, 60, 200];
export const TRUTH = "#b6ff5c";

function packed(red: number, green: number, blue: number): number {
  return (255 << 24) | (blue << 16) | (green << 8) | red; // as a little-endian canvas has it
}

/** Grey for each value that can be sent. */
export const GREY = Uint32Array.from({ length: 256 }, (_, value) => packed(value, value, value));

/** Blue over near-white to red-brown: what is too dark and too bright, for residuals. */
export const DIVERGING = Uint32Array.from({ length: 256 }, (_, value) => {
  const t = (value - 127.5) / 127.5;
  const stops: [number, number, number][] = t < 0
    ? [[247, 247, 247], [146, 197, 222], [33, 102, 172], [5, 48, 97]]
    : [[247, 247, 247], [244, 165, 130], [178, 50, 43], [103, 0, 31]];
  const at = Math.min(2.999, Math.abs(t) * 3);
  const [from, to] = [stops[Math.floor(at)]!, stops[Math.floor(at) + 1]!];
  const mixed = from.map((c, i) => Math.round(c + (to[i]! - c) * (at % 1)));
  return packed(mixed[0]!, mixed[1]!, mixed[2]!);
});

/** One of the page's own colours, as the style has it for light or dark. */
export function themed(name: string): string {
  return getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
}
