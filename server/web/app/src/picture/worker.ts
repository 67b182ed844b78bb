// A picture on a thread of its own: its stream, what is drawn, and what was seen before a pause. So the page's thread has nothing to
// do with pixels, and hears a few times a second what is shown.
import { DIVERGING, GREY } from "../draw/colour";
import type { Stream } from "../state/stream";
import { NOTHING_TOLD, type Look, type Order, type Part, type Told } from "./messages";
import { Picture } from "./picture";
import { preview, type Preview } from "./preview";

const page = self as unknown as { postMessage(told: Told): void; onmessage: (event: MessageEvent<Order>) => void };

/** Pictures that are kept to step back through when paused. */
const KEPT_BYTES: Record<Part, number> = { frame: 24_000_000, residual: 6_000_000 };
const TELL_MS = 200;
/** Who cannot be seen is sent so little. */
const HIDDEN_MS = 500;

let picture: Picture | null = null;
let part: Part = "frame";
let following: Stream | null = null;
const look: Look = { width: 0, height: 0, ratio: 1, centre: [], rateHz: 30, isHidden: false, isPaused: false, pointer: null };
const told: Told = { ...NOTHING_TOLD };

const kept: Preview[] = [];
let keptBytes = 0;

/** What a picture takes, its pixels decoded. */
function bytesOf({ pixels, bitmap }: Preview): number {
  return pixels.length + (bitmap ? 4 * bitmap.width * bitmap.height : 0);
}

function keep(shown: Preview) {
  kept.push(shown);
  keptBytes += bytesOf(shown);
  while (keptBytes > KEPT_BYTES[part] && kept.length > 1) drop(kept.shift()!);
}

function drop(old: Preview) {
  keptBytes -= bytesOf(old);
  old.bitmap?.close();
}

let timer = 0;
let lastTold = 0;

function tell() {
  clearTimeout(timer);
  timer = 0;
  lastTold = performance.now();
  if (picture) {
    told.value = look.pointer ? picture.valueAt(look.pointer.x, look.pointer.y) : "";
    told.ellipseScale = picture.ellipseScale;
    told.isZoomed = picture.isZoomed;
  }
  page.postMessage(told);
}

function tellSoon() {
  timer ||= self.setTimeout(tell, Math.max(0, lastTold + TELL_MS - performance.now()));
}

function show(shown: Preview) {
  picture?.show(shown);
  const { frame, frame_size, slice, width, height, section, saturated, outline } = shown.head;
  told.head = { frame, frame_size, slice, width, height, section, hasSaturated: Boolean(saturated?.length), hasEdge: Boolean(outline?.length) };
}

function follow(path: string, protocols: string[]) {
  following?.close();
  kept.splice(0).forEach(drop);
  Object.assign(told, { lacking: NOTHING_TOLD.lacking, stepsBack: 0 });
  tell();
  if (!path) return;
  following = preview(path, protocols, part, look, {
    async show(message) {
      const wasLacking = told.lacking !== "";
      told.lacking = "";
      if (!look.isPaused) {
        keep(message);
        show(message);
        if (wasLacking) tell();
        else tellSoon();
      }
      if (look.isHidden) await new Promise((done) => setTimeout(done, HIDDEN_MS));
    },
    gone(reason) {
      told.lacking = reason || "no picture: the service has closed the stream; trying again";
      tell();
    },
    link(words) {
      told.link = words;
      tellSoon();
    },
  });
}

/** Shows what was seen so many pictures before the last. */
function back(steps: number) {
  told.stepsBack = Math.max(0, Math.min(kept.length - 1, steps));
  const at = kept[kept.length - 1 - told.stepsBack];
  if (at) show(at);
}

page.onmessage = ({ data: order }) => {
  switch (order.kind) {
    case "begin":
      part = order.part;
      picture = new Picture(order.canvas, part === "frame" ? GREY : DIVERGING, look);
      return;
    case "follow": return follow(order.path, order.protocols);
    case "look":
      Object.assign(look, order.look);
      if (!look.isPaused) told.stepsBack = 0;
      if ("width" in order.look) picture?.paint();
      break;
    case "zoom": picture?.zoom(order.factor, order.at); break;
    case "pan": picture?.pan(order.dx, order.dy); break;
    case "fit": picture?.fit(); break;
    case "stretch": picture?.stretch(); break;
    case "step": back(told.stepsBack - order.by); break;
    case "seek": {
      const after = kept.findIndex((one) => one.head.frame > order.frame);
      back(after < 0 ? 0 : kept.length - after);
    }
  }
  tell();
};
