// The picture with what was fitted, the residual beside it, and what both mean.
import { useSignal } from "@preact/signals";
import { useEffect } from "preact/hooks";
import { Formulas } from "../parts/Formulas";
import { Parameters } from "../parts/Parameters";
import { PoseView } from "../parts/Pose";
import { Residual } from "../parts/Residual";
import { Screen } from "../parts/Screen";
import { Section } from "../parts/Section";
import { Status } from "../parts/Status";
import { SwapLine } from "../parts/SwapLine";
import { get, segment } from "../state/api";
import { beginDemo } from "../state/demo";
import { shownHead } from "../state/pictures";
import { standing } from "../state/standing";
import { document_, models, session } from "../state/store";
import { swap, swapNews } from "../state/swap";

export function Live() {
  if (standing.value.word === "first start") return <FirstStart />;
  return (
    <div class="live">
      <div class="column">
        <Screen />
        <TheFormula />
      </div>
      <div class="column">
        <Residual title="Residual" />
        <Section head={shownHead} />
      </div>
      <div class="column beside">
        <Status />
        <Parameters />
        <PoseView />
      </div>
    </div>
  );
}

/** The formula that is fitted, and one button that puts another in its place while the camera runs. */
function TheFormula() {
  const text = useSignal("");
  const one = session.value;
  const active = one?.active_model ?? "";
  const digest = one?.active_digest ?? "";
  useEffect(() => {
    if (!active) return;
    let isWanted = true;
    // By this method models of any size can be derived; the formulas are the same by each.
    get<{ text: string }>(`/v1/models/${segment(active)}/explain?show=formulas&method=levenberg-marquardt`)
      .then((found) => found.text, () => "")
      .then((found) => { if (isWanted) text.value = found; });
    return () => { isWanted = false; };
  }, [active, digest]);
  const other = active === "gaussian" ? "spot" : "gaussian";
  const offered = models.value.filter((model) => model.name !== active);
  return (
    <section class="formula-card">
      <h3>The formula <small class="quiet">{active}{document_.value?.description ? ` · ${document_.value.description}` : ""}</small></h3>
      <Formulas key={digest} text={text.value} keys={(key) => /^definitions\.|^model\.(intensity|domain)/.test(key)} />
      <p class="row">
        <button class="primary" id="swap" disabled={!one || swapNews.value?.isWaiting} onClick={() => one && void swap(one.name, other)}>
          Fit {other} instead
        </button>
        <label>or <select aria-label="another model" value="" onChange={(event) => one && event.currentTarget.value && void swap(one.name, event.currentTarget.value)}>
          <option value="">another …</option>
          {offered.map((model) => <option key={model.name} value={model.name}>{model.name}</option>)}
        </select></label>
        <a href="#model">edit it</a>
      </p>
      <SwapLine />
    </section>
  );
}

function FirstStart() {
  const fault = useSignal("");
  return (
    <div class="welcome">
      <h2>A formula in, a tracker out</h2>
      <p>isophote fits a formula for pixel brightness to every frame of a camera. Nothing runs here yet.</p>
      <p class="row">
        <button class="primary" onClick={() => beginDemo().then((said) => { fault.value = said; })}>Start the demo</button>
        <a class="button" href="#sources">Choose a camera or a recording</a>
      </p>
      {fault.value && <p class="fault" role="alert">{fault.value}</p>}
      <p class="quiet">The demo is a synthetic camera: a spot that moves, with the noise of a real sensor.</p>
    </div>
  );
}
