// A slider with its value and unit beside it.
interface Props {
  label: string;
  unit: string;
  value: number;
  min: number;
  max: number;
  step: number;
  set(value: number): void;
  disabled?: boolean;
  shown?: string;
}

export function Slider({ label, unit, value, min, max, step, set, disabled, shown }: Props) {
  return (
    <label class="slider">
      <span>{label}</span>
      <input type="range" {...{ min, max, step, disabled }} value={value} aria-label={label} onInput={(event) => set(Number(event.currentTarget.value))} />
      <output>{shown ?? value} {unit}</output>
    </label>
  );
}
