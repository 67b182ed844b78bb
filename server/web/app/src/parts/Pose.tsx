// The pose as a small view in three dimensions: the target's axes as the camera would see them, and its distance in numbers.
import { useEffect, useRef } from "preact/hooks";
import { themed } from "../draw/colour";
import { withSigma } from "../format";
import { Unseen } from "./Unseen";
import { beat, current, newest } from "../state/store";

type Vector = [number, number, number];

/** Axes of the target in camera axes: the columns of a unit quaternion's matrix. */
function axes([x = 0, y = 0, z = 0, w = 1]: number[]): Vector[] {
  return [
    [1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)],
    [2 * (x * y - z * w), 1 - 2 * (x * x + z * z), 2 * (y * z + x * w)],
    [2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)],
  ];
}

function draw(canvas: HTMLCanvasElement, orientation: number[]) {
  const ratio = window.devicePixelRatio;
  const side = Math.round(canvas.clientWidth * ratio);
  if (side === 0) return;
  canvas.width = canvas.height = side;
  const context = canvas.getContext("2d")!;
  const place = ([x, y, z]: Vector): [number, number] => {
    const depth = 1 / (1 + 0.22 * z); // a weak perspective: what is nearer is larger
    return [side / 2 + x * depth * side * 0.32, side / 2 + y * depth * side * 0.32];
  };
  const line = (from: Vector, to: Vector, colour: string, width: number) => {
    context.strokeStyle = colour;
    context.lineWidth = width * ratio;
    context.beginPath();
    context.moveTo(...place(from));
    context.lineTo(...place(to));
    context.stroke();
  };
  const turned = axes(orientation);
  const [ex, ey] = [turned[0]!, turned[1]!];
  const corner = (a: number, b: number): Vector => [0, 1, 2].map((i) => 0.6 * (a * ex[i]! + b * ey[i]!)) as Vector;
  const corners = [corner(-1, -1), corner(1, -1), corner(1, 1), corner(-1, 1)];
  corners.forEach((from, i) => line(from, corners[(i + 1) % 4]!, themed("rule"), 1.5));
  const names = ["x", "y", "z"];
  const order = [0, 1, 2].sort((a, b) => turned[b]![2] - turned[a]![2]);
  for (const i of order) {
    const colour = themed(`axis-${names[i]}`);
    line([0, 0, 0], turned[i]!, colour, 2.5);
    const [x, y] = place(turned[i]!.map((c) => c * 1.18) as Vector);
    context.fillStyle = colour;
    context.font = `${12 * ratio}px system-ui, sans-serif`;
    context.textAlign = "center";
    context.textBaseline = "middle";
    context.fillText(names[i]!, x, y);
  }
}

export function PoseView() {
  void beat.value;
  const canvas = useRef<HTMLCanvasElement>(null);
  const pose = newest.peek()?.pose;
  const isSeen = current() !== null;
  useEffect(() => { if (pose && isSeen && canvas.current) draw(canvas.current, pose.orientation_xyzw); });
  if (!pose) return null;
  const rows = pose.position_mm.map((value, i) => {
    if (!isSeen) return { name: "xyz"[i], shown: "–", sigma: "–" };
    const variance = pose.covariance?.[i * 7];
    const [shown, sigma] = withSigma(value, variance === undefined ? NaN : Math.sqrt(variance));
    return { name: "xyz"[i], shown, sigma: variance === undefined ? "" : `± ${sigma}` };
  });
  return (
    <section class="pose" aria-label="pose">
      <h3>Pose <small class="quiet">of the target, as the camera sees it</small></h3>
      <canvas ref={canvas} hidden={!isSeen} role="img" aria-label="the target's axes" />
      <table class="parameters"><tbody><Unseen />
        {rows.map((row) => (
          <tr key={row.name}><th scope="row">{row.name}</th><td class="number">{row.shown}</td><td class="number">{row.sigma}</td><td>mm</td></tr>
        ))}
      </tbody></table>
    </section>
  );
}
