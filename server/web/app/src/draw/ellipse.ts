// Ellipses of uncertainty.
import type { Estimate } from "../types";

export interface Ellipse { x: number; y: number; long: number; short: number; angle: number }

/** The 1σ ellipse of two parameters; null where their covariance is not known. */
export function ellipse(estimate: Estimate, centre: string[]): Ellipse | null {
  const [first, second] = centre;
  if (first === undefined || second === undefined) return null;
  const [x, y] = [estimate.parameters[first], estimate.parameters[second]];
  const [i, j] = [estimate.order.indexOf(first), estimate.order.indexOf(second)];
  const matrix = estimate.covariance;
  if (x === undefined || y === undefined || i < 0 || j < 0 || !matrix) return null;
  const [a, b, c] = [matrix[i]?.[i] ?? 0, matrix[i]?.[j] ?? 0, matrix[j]?.[j] ?? 0];
  const mean = (a + c) / 2;
  const spread = Math.hypot((a - c) / 2, b);
  const [long, short] = [Math.sqrt(Math.max(0, mean + spread)), Math.sqrt(Math.max(0, mean - spread))];
  return { x, y, long, short, angle: Math.atan2(2 * b, a - c) / 2 };
}

/** The standard deviation of a parameter; undefined of one that is held. */
export function sigmaOf(estimate: Estimate, name: string): number | undefined {
  const at = estimate.order.indexOf(name);
  const variance = at < 0 ? undefined : estimate.covariance?.[at]?.[at];
  return variance === undefined ? undefined : Math.sqrt(Math.max(0, variance));
}
