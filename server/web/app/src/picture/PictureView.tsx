// A picture that can be zoomed and panned, by wheel, fingers, buttons and keys; it says what is under the pointer.
import { useComputed, useSignal, type Signal } from "@preact/signals";
import { useEffect, useRef } from "preact/hooks";
import { RemotePicture, type Subject } from "./remote";

interface Props extends Subject {
  label: string;
  /** Of the canvas, as in CSS. */
  ratio: string;
  /** Where the picture is to be found while it is on the page. */
  picture?: Signal<RemotePicture | null>;
  stretches?: true;
}

export function PictureView({ label, part, shadow, ratio, picture, stretches }: Props) {
  const canvas = useRef<HTMLCanvasElement>(null);
  const made = useSignal<RemotePicture | null>(null);
  const value = useComputed(() => made.value?.told.value.value ?? "");
  const pointers = useRef(new Map<number, { x: number; y: number }>());

  useEffect(() => {
    const element = canvas.current!;
    const remote = new RemotePicture(element, { part, shadow });
    made.value = remote;
    if (picture) picture.value = remote;
    const wheel = (event: WheelEvent) => {
      event.preventDefault();
      remote.order({ kind: "zoom", factor: Math.exp(-event.deltaY / 300), at: { x: event.offsetX, y: event.offsetY } });
    };
    element.addEventListener("wheel", wheel, { passive: false });
    return () => {
      element.removeEventListener("wheel", wheel);
      remote.close();
      if (picture) picture.value = null;
    };
  }, []);

  const zoom = (factor: number, at?: { x: number; y: number }) => made.value?.order({ kind: "zoom", factor, at });
  const pan = (dx: number, dy: number) => made.value?.order({ kind: "pan", dx, dy });
  const fit = () => made.value?.order({ kind: "fit" });
  const stretch = () => made.value?.order({ kind: "stretch" });

  const move = (event: PointerEvent) => {
    const now = { x: event.offsetX, y: event.offsetY };
    made.value?.look({ pointer: now });
    const held = pointers.current;
    const before = held.get(event.pointerId);
    if (!before) return;
    if (held.size === 2) {
      const other = [...held].find(([id]) => id !== event.pointerId)![1];
      const length = (a: { x: number; y: number }) => Math.hypot(a.x - other.x, a.y - other.y);
      zoom(length(now) / Math.max(1, length(before)), { x: (now.x + other.x) / 2, y: (now.y + other.y) / 2 });
    } else {
      pan(now.x - before.x, now.y - before.y);
    }
    held.set(event.pointerId, now);
  };
  const key = (event: KeyboardEvent) => {
    const step = 40;
    const act: Record<string, () => void> = {
      "+": () => zoom(1.4), "=": () => zoom(1.4), "-": () => zoom(1 / 1.4), "0": fit, ...(stretches ? { c: stretch } : {}),
    };
    if (made.value?.isZoomed) {
      Object.assign(act, {
        ArrowLeft: () => pan(step, 0), ArrowRight: () => pan(-step, 0), ArrowUp: () => pan(0, step), ArrowDown: () => pan(0, -step),
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
      <canvas
        ref={canvas} tabIndex={0} role="img" style={{ aspectRatio: ratio }} aria-label={`${label}; plus and minus zoom, arrows pan, 0 shows all`}
        onPointerMove={move} onKeyDown={key}
        onPointerDown={(event) => {
          pointers.current.set(event.pointerId, { x: event.offsetX, y: event.offsetY });
          if (made.value?.isZoomed || pointers.current.size > 1) event.currentTarget.setPointerCapture(event.pointerId);
        }}
        onPointerUp={(event) => pointers.current.delete(event.pointerId)}
        onPointerCancel={(event) => pointers.current.delete(event.pointerId)}
        onPointerLeave={() => { made.value?.look({ pointer: null }); pointers.current.clear(); }}
        onDblClick={fit}
      />
      <span class="caption">{label}</span>
      <output class="pixel">{value}</output>
      <div class="zoom">
        {stretches && <button title="stretch the contrast" aria-label={`${label}: stretch the contrast`} onClick={stretch}>◐</button>}
        <button title="larger" aria-label={`${label}: larger`} onClick={() => zoom(1.4)}>+</button>
        <button title="smaller" aria-label={`${label}: smaller`} onClick={() => zoom(1 / 1.4)}>−</button>
        <button title="show all" aria-label={`${label}: show all`} onClick={fit}>⤢</button>
      </div>
    </div>
  );
}
