// The first minute: five steps, closed for good by one button.
import { useSignal } from "@preact/signals";

const STEPS: { view: string; title: string; text: string }[] = [
  { view: "live", title: "The picture", text: "A camera, live. The orange line is the outline that was fitted, the cyan cross its centre; the ellipse says how sure." },
  { view: "live", title: "Residual", text: "Beside the picture: every parameter ± its standard deviation. Below: the residual, where noise without a pattern means that the formula explains the light." },
  { view: "live", title: "Another formula", text: "The button under the formula puts another one in its place between two frames, while the camera runs." },
  { view: "model", title: "Your formula", text: "Edit the document: mistakes are underlined as you type, and Ctrl-Enter fits what you wrote." },
  { view: "sources", title: "Break it", text: "Add glare, noise, motion; see when it is not sure any more, and how it says so. Then choose your own camera." },
];
const CLOSED = "isophote.walk";

function isClosed(): boolean {
  try { return localStorage.getItem(CLOSED) === "closed"; } catch { return false; }
}

export function Walk() {
  const at = useSignal(isClosed() ? -1 : 0);
  const step = STEPS[at.value];
  if (!step) return null;
  const go = (to: number) => {
    const next = STEPS[to];
    if (!next) return close();
    at.value = to;
    location.hash = next.view;
  };
  const close = () => {
    at.value = -1;
    try { localStorage.setItem(CLOSED, "closed"); } catch { /* asked again next time */ }
  };
  return (
    <aside class="walk" aria-label="first steps">
      <p><b>{at.value + 1} of {STEPS.length} · {step.title}.</b> {step.text}</p>
      <p class="row">
        {at.value > 0 && <button onClick={() => go(at.value - 1)}>Back</button>}
        <button class="primary" onClick={() => go(at.value + 1)}>{at.value + 1 < STEPS.length ? "Next" : "Done"}</button>
        <button class="plain" id="close-walk" onClick={close}>Close for good</button>
      </p>
    </aside>
  );
}
