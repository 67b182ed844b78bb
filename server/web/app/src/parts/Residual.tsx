// What the formula leaves unexplained, of the session or of its shadow, on a diverging scale.
import { useComputed, useSignal, useSignalEffect } from "@preact/signals";
import { PictureView } from "../picture/PictureView";
import type { RemotePicture, Subject } from "../picture/remote";
import { shownHead } from "../state/pictures";
import { paused } from "../state/store";

/** In few steps, so that the layout stands still while a window breathes. */
function aspect(width: number, height: number): string {
  const ratio = Math.max(0.7, Math.min(1.8, width / Math.max(1, height)));
  return `${Math.round(ratio * 5) / 5} / 1`;
}

export function Residual({ title, shadow }: { title: string } & Pick<Subject, "shadow">) {
  const picture = useSignal<RemotePicture | null>(null);
  const ratio = useComputed(() => {
    const head = picture.value?.told.value.head;
    return head ? aspect(head.width, head.height) : "1 / 1";
  });
  const lacking = useComputed(() => picture.value?.told.value.lacking ?? "");
  // It follows the steps of the picture beside it.
  useSignalEffect(() => {
    const frame = shownHead.value?.frame;
    if (paused.value && frame !== undefined) picture.value?.order({ kind: "seek", frame });
  });
  return (
    <figure class="residual">
      <figcaption>{title} <small class="quiet">measured − model, in σ</small></figcaption>
      <PictureView label={title.toLowerCase()} part="residual" shadow={shadow} picture={picture} ratio={ratio.value} />
      {lacking.value && <p class="quiet">{lacking.value}</p>}
      <p class="scale"><span>−5 σ</span><i /><span>+5 σ</span></p>
    </figure>
  );
}
