// A picture pixel by pixel, enlarged and moved, and what was fitted above it. Frame coordinates are the service's: (0, 0) is the centre
// of the top-left pixel.
import { CENTRE, CONTOUR, GREY, SATURATED } from "../draw/colour";
import { ellipse } from "../draw/ellipse";
import type { Estimate, PreviewHead } from "../types";
import type { Look } from "./messages";
import type { Preview } from "./preview";

/** Which part of the frame is seen: the frame pixel at the canvas' top-left corner, and canvas pixels a frame pixel. */
interface View { x: number; y: number; zoom: number }

const ZOOM_MAX = 64;
/** The ellipse of 1σ is a few hundredths of a pixel: drawn so many times larger, and said so. */
const ELLIPSE_PX = 14;

export class Picture {
  private readonly probe = new OffscreenCanvas(1, 1).getContext("2d", { willReadFrequently: true })!;
  /** As it came. */
  private readonly source = new OffscreenCanvas(1, 1);
  private image: ImageData | null = null;
  private head: PreviewHead | null = null;
  private last: Preview | null = null;
  private view: View | null = null;
  /** How many times larger than it is the ellipse is drawn. */
  ellipseScale = 1;

  constructor(private readonly canvas: OffscreenCanvas, private readonly palette: Uint32Array, private readonly look: Readonly<Look>) {}

  /** Whether the darkest pixel is shown black and the brightest white. */
  isStretched = false;
  private stretched = { low: 0, high: 255, palette: new Uint32Array(256) };

  private paletteFor(pixels: Uint8Array): Uint32Array {
    if (!this.isStretched) return this.palette;
    let [low, high] = [255, 0];
    for (let i = 0; i < pixels.length; i += 7) {
      const value = pixels[i]!;
      if (value < low) low = value;
      if (value > high) high = value;
    }
    const kept = this.stretched; // follows slowly, so that noise does not make the picture flicker
    kept.low += (low - kept.low) * 0.2;
    kept.high += (high - kept.high) * 0.2;
    const range = Math.max(1, kept.high - kept.low);
    for (let i = 0; i < 256; i++) kept.palette[i] = this.palette[Math.max(0, Math.min(255, Math.round((i - kept.low) / range * 255)))]!;
    return kept.palette;
  }

  show(preview: Preview) {
    const { head, bitmap } = preview;
    const before = this.head;
    if (before && (before.part !== head.part || before.frame_size.join() !== head.frame_size.join())) this.view = null;
    this.head = head;
    this.last = preview;
    if (this.source.width !== head.width || this.source.height !== head.height || !this.image) {
      this.source.width = head.width;
      this.source.height = head.height;
      this.image = new ImageData(head.width, head.height);
    }
    const context = this.source.getContext("2d", { alpha: false })!;
    if (bitmap && this.palette === GREY && !this.isStretched) {
      context.drawImage(bitmap, 0, 0);
    } else {
      const out = new Uint32Array(this.image.data.buffer);
      const pixels = bitmap ? this.levels(bitmap) : preview.pixels;
      const palette = this.paletteFor(pixels);
      for (let i = 0; i < pixels.length && i < out.length; i++) out[i] = palette[pixels[i]!]!;
      this.markSaturated(out);
      context.putImageData(this.image, 0, 0);
    }
    this.paint();
  }

  /** The grey levels of a compressed picture. */
  private levels(bitmap: ImageBitmap): Uint8Array {
    const { canvas } = this.probe;
    if (canvas.width < bitmap.width || canvas.height < bitmap.height) [canvas.width, canvas.height] = [bitmap.width, bitmap.height];
    this.probe.drawImage(bitmap, 0, 0);
    const { data } = this.probe.getImageData(0, 0, bitmap.width, bitmap.height);
    return Uint8Array.from({ length: bitmap.width * bitmap.height }, (_, i) => data[4 * i + 1]!);
  }

  private markSaturated(out: Uint32Array) {
    const { saturated, origin, step, width, height } = this.head!;
    if (!saturated || step !== 1) return;
    const [red, green, blue] = SATURATED;
    const mark = (255 << 24) | (blue << 16) | (green << 8) | red;
    for (const [y, from, to] of saturated) {
      const row = y - origin[1];
      if (row < 0 || row >= height) continue;
      for (let x = Math.max(0, from - origin[0]); x <= Math.min(width - 1, to - origin[0]); x++) {
        if ((x + row) % 2 === 0) out[row * width + x] = mark; // every other one: what lies under it stays visible
      }
    }
  }

  /** The area that is shown when nothing was zoomed, with its edges: the frame, or of a residual its window. */
  private area(): { x: number; y: number; width: number; height: number } {
    const head = this.head!;
    if (head.part === "frame") return { x: -0.5, y: -0.5, width: head.frame_size[0], height: head.frame_size[1] };
    const [x, y] = head.origin;
    return { x: x - head.step / 2, y: y - head.step / 2, width: head.width * head.step, height: head.height * head.step };
  }

  private fitted(): View {
    const area = this.area();
    const zoom = Math.min(this.canvas.width / area.width, this.canvas.height / area.height);
    return {
      x: area.x - (this.canvas.width / zoom - area.width) / 2,
      y: area.y - (this.canvas.height / zoom - area.height) / 2,
      zoom,
    };
  }

  private seen(): View {
    return this.view ?? this.fitted();
  }

  /** Zooms by a factor about a place on the canvas, in CSS pixels; without a place about the middle. */
  zoom(factor: number, at?: { x: number; y: number }) {
    if (!this.head) return;
    const ratio = this.look.ratio;
    const [px, py] = at ? [at.x * ratio, at.y * ratio] : [this.canvas.width / 2, this.canvas.height / 2];
    const seen = this.seen();
    const least = this.fitted().zoom;
    const zoom = Math.max(least, Math.min(ZOOM_MAX * ratio, seen.zoom * factor));
    this.view = zoom === least ? null : { x: seen.x + px / seen.zoom - px / zoom, y: seen.y + py / seen.zoom - py / zoom, zoom };
    this.paint();
  }

  pan(dx: number, dy: number) {
    if (!this.head || !this.view) return;
    const ratio = this.look.ratio;
    this.view.x -= dx * ratio / this.view.zoom;
    this.view.y -= dy * ratio / this.view.zoom;
    this.paint();
  }

  stretch() {
    this.isStretched = !this.isStretched;
    if (this.last) this.show(this.last);
  }

  fit() {
    this.view = null;
    this.paint();
  }

  get isZoomed(): boolean {
    return this.view !== null;
  }

  /** The frame pixel under a place of the canvas (CSS pixels), and its value in words. */
  valueAt(x: number, y: number): string {
    const head = this.head;
    if (!head) return "";
    const ratio = this.look.ratio;
    const seen = this.seen();
    const [fx, fy] = [seen.x + x * ratio / seen.zoom, seen.y + y * ratio / seen.zoom];
    const [i, j] = [Math.round((fx - head.origin[0]) / head.step), Math.round((fy - head.origin[1]) / head.step)];
    const place = `x ${Math.round(fx)}  y ${Math.round(fy)}`;
    if (i < 0 || j < 0 || i >= head.width || j >= head.height) return place;
    const sent = this.last?.bitmap ? this.grey(i, j) : this.last?.pixels[j * head.width + i];
    if (sent === undefined) return place;
    const value = head.levels.low + (sent / 255) * (head.levels.high - head.levels.low);
    if (head.part === "residual") return `${place}  ${value.toFixed(1).replace("-", "\u2212")} σ`;
    return `${place}  ${this.last?.bitmap ? "≈ " : ""}${Math.round(value)} DN`;
  }

  private grey(i: number, j: number): number | undefined {
    this.probe.drawImage(this.source, i, j, 1, 1, 0, 0, 1, 1);
    return this.probe.getImageData(0, 0, 1, 1).data[1];
  }

  paint() {
    const { canvas, head } = this;
    const { width, height, ratio } = this.look;
    if (width === 0 || height === 0) return;
    if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
    const context = canvas.getContext("2d", { alpha: false })!;
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.fillStyle = this.palette === GREY ? "#000" : "#f7f7f7";
    context.fillRect(0, 0, width, height);
    if (!head) return;
    const seen = this.seen();
    const to = (x: number, y: number): [number, number] => [(x - seen.x) * seen.zoom, (y - seen.y) * seen.zoom];
    const [left, top] = to(head.origin[0] - head.step / 2, head.origin[1] - head.step / 2);
    const side = head.step * seen.zoom;
    context.imageSmoothingEnabled = side < 1.5 * ratio;
    context.drawImage(this.source, left, top, head.width * side, head.height * side);
    this.overlay(context, to, ratio, seen.zoom);
  }

  private overlay(context: OffscreenCanvasRenderingContext2D, to: (x: number, y: number) => [number, number], ratio: number, zoom: number) {
    const head = this.head!;
    const line = (colour: string, width: number, draw: () => void) => {
      // A dark line under each: seen on white as well.
      for (const [style, wide] of [["rgba(0,0,0,.55)", width + 2], [colour, width]] as const) {
        context.strokeStyle = style;
        context.lineWidth = wide * ratio;
        context.beginPath();
        draw();
        context.stroke();
      }
    };
    if (head.part === "frame" && head.window) {
      const { x, y, width, height } = head.window;
      const [x0, y0] = to(x - 0.5, y - 0.5);
      context.strokeStyle = "rgba(255,255,255,.55)";
      context.lineWidth = ratio;
      context.setLineDash([4 * ratio, 4 * ratio]);
      context.strokeRect(x0, y0, width * zoom, height * zoom);
      context.setLineDash([]);
    }
    const follow = (path: [number, number][]) => path.forEach(([x, y], i) => (i === 0 ? context.moveTo(...to(x, y)) : context.lineTo(...to(x, y))));
    // Where there is an outline, the edge of the domain says only which pixels were fitted.
    const [drawn, edges] = head.outline?.length ? [head.outline, head.contour ?? []] : [head.contour ?? [], []];
    context.setLineDash([6 * ratio, 5 * ratio]);
    context.strokeStyle = CONTOUR;
    context.lineWidth = ratio;
    for (const path of edges) {
      context.beginPath();
      follow(path);
      context.stroke();
    }
    context.setLineDash([]);
    for (const path of drawn) line(CONTOUR, 1.8, () => follow(path));
    for (const estimate of head.estimates ?? (head.estimate ? [head.estimate] : [])) this.cross(context, to, ratio, zoom, estimate, line);
    for (const axis of head.axes ?? []) {
      const colour = { x: "#ff7b72", y: "#7ee787", z: "#79c0ff" }[axis.axis] ?? "#fff";
      line(colour, 2.2, () => { context.moveTo(...to(...axis.from)); context.lineTo(...to(...axis.to)); });
    }
  }

  private cross(
    context: OffscreenCanvasRenderingContext2D, to: (x: number, y: number) => [number, number], ratio: number, zoom: number,
    estimate: Estimate, line: (colour: string, width: number, draw: () => void) => void,
  ) {
    const names = this.look.centre;
    const [cx, cy] = [estimate.parameters[names[0] ?? ""], estimate.parameters[names[1] ?? ""]];
    if (cx === undefined || cy === undefined || estimate.state === "searching" || estimate.state === "lost") return;
    const [x, y] = to(cx, cy);
    const arm = 7 * ratio;
    line(CENTRE, 1.6, () => {
      context.moveTo(x - arm, y); context.lineTo(x + arm, y);
      context.moveTo(x, y - arm); context.lineTo(x, y + arm);
    });
    const found = ellipse(estimate, names);
    if (!found || !(found.long > 0)) return;
    const scale = scaled(ELLIPSE_PX * ratio / (found.long * zoom));
    this.ellipseScale = scale;
    line(CENTRE, 1, () => context.ellipse(x, y, found.long * zoom * scale, found.short * zoom * scale, found.angle, 0, 2 * Math.PI));
  }
}

/** 1, 2, 5, 10 …: the largest that is at most this. */
function scaled(most: number): number {
  if (most <= 1) return 1;
  const power = 10 ** Math.floor(Math.log10(most));
  return power * ([5, 2, 1].find((step) => step * power <= most) ?? 1);
}
