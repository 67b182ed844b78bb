// Pictures of a session, as they come. Where the link is slow they come smaller: compressed, then fewer, then scaled down.
import { stream, type Stream } from "../state/stream";
import type { PreviewHead } from "../types";
import type { Look, Part } from "./messages";

/** A picture as it came. */
export interface Preview {
  head: PreviewHead;
  /** Of raw formats; a compressed one is decoded by the browser. */
  pixels: Uint8Array;
  bitmap?: ImageBitmap;
}

interface Rung { format: "raw8" | "jpeg"; rate: number; scale: number }

const LADDER: Rung[] = [
  { format: "raw8", rate: 30, scale: 1 },
  { format: "jpeg", rate: 30, scale: 1 },
  { format: "jpeg", rate: 12, scale: 1 },
  { format: "jpeg", rate: 8, scale: 0.5 },
  { format: "jpeg", rate: 4, scale: 0.25 },
];
const WATCH_MS = 3000;
/** After so many quiet spans of watching a better picture is tried again; each failure doubles it. */
const PATIENCE = 4;
/** Raw pictures of this size at 30 Hz are more than most machines draw for nothing. */
const RAW_BYTES_MAX = 1_500_000;

/** Residuals are looked at, not watched. */
const RESIDUAL_HZ = 10;

export function decoded(data: ArrayBuffer): { head: PreviewHead; pixels: Uint8Array } {
  const length = new DataView(data).getUint32(0, true);
  const head = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length))) as PreviewHead;
  return { head, pixels: new Uint8Array(data, 4 + length) };
}

function isLocal(): boolean {
  return /^(localhost|127\.|\[::1\])/.test(location.hostname);
}

export interface PreviewListener {
  /** The next one comes when it is done with this one. */
  show(preview: Preview): Promise<void>;
  /** Why there is no picture. */
  gone(reason: string): void;
  /** How pictures come: for people. */
  link(words: string): void;
}

/** Follows the pictures at a path until closed, as they are looked at now. */
export function preview(path: string, protocols: string[], part: Part, look: Readonly<Look>, listener: PreviewListener): Stream {
  let rung = isLocal() ? 0 : 1;
  let quiet = 0;
  let patience = PATIENCE;
  let count = 0;
  let isClosed = false;
  let current: Stream | null = null;

  const hzOf = (one: Rung) => (part === "frame" ? one.rate : Math.min(RESIDUAL_HZ, one.rate));
  const asked = () => {
    const { format, scale } = LADDER[rung]!;
    return `${path}&format=${format}&rate=${hzOf(LADDER[rung]!)}&scale=${scale}&credit=2`;
  };
  const open = () => {
    listener.link(describe(LADDER[rung]!));
    current = stream(asked, protocols, {
      async message(data) {
        if (typeof data === "string" || isClosed) return;
        const message: Preview = decoded(data);
        if (message.head.format === "jpeg") {
          message.bitmap = await createImageBitmap(new Blob([message.pixels as BlobPart], { type: "image/jpeg" }));
        } else if (rung === 0 && message.pixels.length > RAW_BYTES_MAX) {
          step(1);
        }
        if (isClosed) return;
        count += 1;
        await listener.show(message);
      },
      open(isOpen, reason) { if (!isOpen) listener.gone(reason); },
    });
  };
  const step = (to: number) => {
    rung = to;
    current?.close();
    open();
  };
  const watch = setInterval(() => {
    const seconds = WATCH_MS / 1000;
    const wanted = Math.min(hzOf(LADDER[rung]!), look.rateHz);
    const isSlow = count > 0 && count / seconds < 0.5 * wanted;
    count = 0;
    if (look.isHidden) return;
    if (isSlow && rung < LADDER.length - 1) {
      if (quiet < PATIENCE) patience = Math.min(64, patience * 2);
      quiet = 0;
      step(rung + 1);
    } else if (!isSlow && rung > (isLocal() ? 0 : 1) && ++quiet >= patience) {
      quiet = 0;
      step(rung - 1);
    }
  }, WATCH_MS);
  open();
  return {
    close() {
      isClosed = true;
      clearInterval(watch);
      current?.close();
    },
  };
}

function describe({ format, rate, scale }: Rung): string {
  const size = scale === 1 ? "" : `, at ${scale * 100} % of its size`;
  return format === "raw8" ? "raw pixels" : `JPEG, up to ${rate} Hz${size}`;
}
