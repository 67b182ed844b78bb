// Parameters in aligned columns: value, ± σ, unit, at the digits that σ allows. Decimals follow a slow mean of σ, so that columns
// do not jump.
import { useRef } from "preact/hooks";
import { beat, centreOf, current, document_, newest } from "../state/store";
import { Unseen } from "./Unseen";
import { decimalsOf, plain, powerOf, powerOfTen, withSigma } from "../format";
import { sigmaOf } from "../draw/ellipse";

export function Parameters() {
  void beat.value;
  const estimate = newest.peek();
  const document = document_.value;
  const steady = useRef(new Map<string, number>());
  if (!estimate) return <p class="quiet">No estimate yet.</p>;
  const isSeen = current() !== null;
  const centre = centreOf(document);
  const names = Object.keys(estimate.parameters);
  const rank = (name: string) => (centre.includes(name) ? 0 : estimate.order.includes(name) ? 1 : 2);
  names.sort((a, b) => rank(a) - rank(b) || estimate.order.indexOf(a) - estimate.order.indexOf(b));
  const rows = names.map((name) => {
    const value = estimate.parameters[name]!;
    const unit = document?.parameters[name]?.unit ?? "";
    const sigma = sigmaOf(estimate, name);
    const isFree = estimate.order.includes(name);
    if (isFree && !isSeen) return { name, value: "–", sigma: "–", unit, kind: "free" };
    if (sigma === undefined) {
      return { name, value: plain(value), sigma: isFree ? "unknown" : "held", unit, kind: "held" };
    }
    const before = steady.current.get(name);
    const mean = before === undefined || !(before > 0) ? sigma : before * Math.exp(0.05 * Math.log(Math.max(sigma, 1e-300) / before));
    steady.current.set(name, mean);
    const power = powerOf(mean);
    const scale = 10 ** -power;
    const [shown, deviation] = withSigma(value * scale, sigma * scale, decimalsOf(mean * scale));
    return { name, value: shown, sigma: `± ${deviation}`, unit: `${powerOfTen(power)} ${unit}`, kind: estimate.at_bounds?.includes(name) ? "bound" : "free" };
  });
  return (
    <table class="parameters">
      <thead><Unseen /><tr><th>parameter</th><th class="number">value</th><th class="number">± σ</th><th>unit</th></tr></thead>
      <tbody>
        {rows.map((row) => (
          <tr key={row.name} class={row.kind}>
            <th scope="row">{row.name}</th>
            <td class="number">{row.value}</td>
            <td class="number">{row.sigma}{row.kind === "bound" && <span class="tag" title="held back by a bound of the document"> at bound</span>}</td>
            <td>{row.unit}</td>
          </tr>
        ))}
      </tbody>
    </table>
  );
}
