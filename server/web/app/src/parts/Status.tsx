// How a session is doing, in one chip and a handful of figures.
import { grouped, plain } from "../format";
import { shownHead } from "../state/pictures";
import { remarks, standing, standingClass } from "../state/standing";
import { beat, current, newest, session, target, targets } from "../state/store";

export function Chip() {
  const now = standing.value;
  return <span class={`chip ${standingClass(now.word)}`} title={now.hint} role="status"><i aria-hidden="true">{now.sign}</i>{now.word}</span>;
}

export function Status() {
  void beat.value;
  const estimate = newest.peek();
  const one = session.value;
  const now = standing.value;
  const fitMs = estimate?.timing_us ? estimate.timing_us.fit / 1000 : undefined;
  const ageMs = estimate?.publish_ns && estimate.capture_ns ? (estimate.publish_ns - estimate.capture_ns) / 1e6 : undefined;
  const seen = current();
  const chi = seen?.reduced_chi_square;
  const confidence = seen?.confidence;
  const figures: [string, string, string][] = [
    ["frame", estimate ? grouped(shownHead.peek()?.frame ?? estimate.frame) : "–", "the source's number"],
    ["rate", one ? `${one.rate_hz.toFixed(1)} Hz` : "–", "frames fitted a second"],
    ["dropped", one ? grouped(one.dropped) : "–", "frames of the source that were not fitted"],
    ["fit", fitMs === undefined ? "–" : `${fitMs.toFixed(2)} ms`, "time of the fit"],
    ["age", ageMs === undefined ? "–" : `${ageMs.toFixed(1)} ms`, "from capture until the estimate was there"],
    ["confidence", confidence === undefined ? "–" : `${(100 * confidence).toFixed(1)} %`, "the probability that the thing tracked is the target"],
    ["χ²/ν", chi === undefined ? "–" : chi.toFixed(2), "near 1 where noise explains what is left"],
    ...(seen?.exposure_advice ? [["exposure", `× ${plain(seen.exposure_advice.factor, 2)}`, `advised: ${seen.exposure_advice.why}`] as [string, string, string]] : []),
    ["saturated", seen ? `${(100 * seen.saturated).toFixed(1)} %` : "–", "of the domain's pixels"],
  ];
  return (
    <section class="status" aria-label="state">
      <p class="row">
        <b>{now.sign} {now.word}</b>
        {now.hint && <span class="quiet">{now.hint}</span>}
        {targets.value.length > 1 && (
          <label>target <select value={target.value} onChange={(event) => { target.value = event.currentTarget.value; }}>
            {targets.value.map((name) => <option key={name}>{name}</option>)}
          </select></label>
        )}
        {estimate && remarks(estimate).map((remark) => <span key={remark.word} class="tag" title={remark.why}>{remark.word}</span>)}
      </p>
      <dl class="figures">
        {figures.map(([name, value, why]) => (
          <div key={name} title={why}>
            <dt>{name}</dt><dd>{value}</dd>
            {name === "confidence" && confidence !== undefined && <meter min={0} max={1} low={0.5} optimum={1} value={plain(confidence, 3)} aria-label="confidence" />}
          </div>
        ))}
      </dl>
    </section>
  );
}
