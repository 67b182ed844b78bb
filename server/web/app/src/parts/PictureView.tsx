// A picture that can be zoomed and panned, by wheel, fingers, buttons and keys; it says what is under the pointer.
import { useSignal, type Signal } from "@preact/signals";
import { useEffect, useRef } from "preact/hooks";
import { Picture } from "../draw/picture";

interface Props {
  label: string;
  palette: Uint32Array;
  centre: () => string[];
  picture: Signal<Picture | null>;
  ratio: string;
  stretches?: true;
}

export function PictureView({ label, palette, centre, picture, ratio, stretches }: Props) {
  const pixels = useRef<HTMLCanvasElement>(null);
  const canvas = useRef<HTMLCanvasElement>(null);
  const value = useSignal("");
  const pointers = useRef(new Map<number, { x: number; y: number }>());

  useEffect(() => {
    const element = canvas.current!;
    const made = new Picture(pixels.current!, element, palette, centre);
    picture.value = made;
    const resized = new ResizeObserver(() => made.paint());
    resized.observe(element);
    const wheel = (event: WheelEvent) => {
      event.preventDefault();
      made.zoom(Math.exp(-event.deltaY / 300), { x: event.offsetX, y: event.offsetY });
    };
    element.addEventListener("wheel", wheel, { passive: false });
    return () => { resized.disconnect(); element.removeEventListener("wheel", wheel); picture.value = null; };
  }, []);

  const move = (event: PointerEvent) => {
    const made = picture.value;
    if (!made) return;
    value.value = made.valueAt(event.offsetX, event.offsetY);
    const held = pointers.current;
    const before = held.get(event.pointerId);
    if (!before) return;
    const now = { x: event.offsetX, y: event.offsetY };
    if (held.size === 2) {
      const other = [...held].find(([id]) => id !== event.pointerId)![1];
      const length = (a: { x: number; y: number }) => Math.hypot(a.x - other.x, a.y - other.y);
      made.zoom(length(now) / Math.max(1, length(before)), { x: (now.x + other.x) / 2, y: (now.y + other.y) / 2 });
    } else {
      made.pan(now.x - before.x, now.y - before.y);
    }
    held.set(event.pointerId, now);
  };
  const key = (event: KeyboardEvent) => {
    const made = picture.value;
    if (!made) return;
    const step = 40;
    const act: Record<string, () => void> = {
      "+": () => made.zoom(1.4), "=": () => made.zoom(1.4), "-": () => made.zoom(1 / 1.4), "0": () => made.fit(), ...(stretches ? { c: () => made.stretch() } : {}),
    };
    if (made.isZoomed) {
      Object.assign(act, {
        ArrowLeft: () => made.pan(step, 0), ArrowRight: () => made.pan(-step, 0),
        ArrowUp: () => made.pan(0, step), ArrowDown: () => made.pan(0, -step),
      });
    }
    const found = act[event.key];
    if (!found) return;
    found();
    event.preventDefault();
    event.stopPropagation();
  };

  return (
    <div class="picture">
      <canvas ref={pixels} class="pixels" width={1} height={1} aria-hidden="true" />
      <canvas
        ref={canvas} class="overlay" tabIndex={0} role="img" style={{ aspectRatio: ratio }} aria-label={`${label}; plus and minus zoom, arrows pan, 0 shows all`}
        onPointerMove={move} onKeyDown={key}
        onPointerDown={(event) => {
          pointers.current.set(event.pointerId, { x: event.offsetX, y: event.offsetY });
          if (picture.value?.isZoomed || pointers.current.size > 1) event.currentTarget.setPointerCapture(event.pointerId);
        }}
        onPointerUp={(event) => pointers.current.delete(event.pointerId)}
        onPointerCancel={(event) => pointers.current.delete(event.pointerId)}
        onPointerLeave={() => { value.value = ""; pointers.current.clear(); }}
        onDblClick={() => picture.value?.fit()}
      />
      <span class="caption">{label}</span>
      <output class="pixel">{value}</output>
      <div class="zoom">
        {stretches && <button title="stretch the contrast" aria-label={`${label}: stretch the contrast`} onClick={() => picture.value?.stretch()}>◐</button>}
        <button title="larger" aria-label={`${label}: larger`} onClick={() => picture.value?.zoom(1.4)}>+</button>
        <button title="smaller" aria-label={`${label}: smaller`} onClick={() => picture.value?.zoom(1 / 1.4)}>−</button>
        <button title="show all" aria-label={`${label}: show all`} onClick={() => picture.value?.fit()}>⤢</button>
      </div>
    </div>
  );
}
