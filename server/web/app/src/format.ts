// Numbers as people read them: as many digits as their standard deviation allows.

const MINUS = "\u2212";

function signed(text: string): string {
  return text.startsWith("-") ? MINUS + text.slice(1) : text;
}

/** Decimals so that a standard deviation has two digits; undefined where powers of ten read better. */
export function decimalsOf(sigma: number): number | undefined {
  if (!(sigma > 0) || !Number.isFinite(sigma)) return undefined;
  const decimals = 1 - Math.floor(Math.log10(sigma));
  return decimals > 9 || decimals < -3 ? undefined : Math.max(0, decimals);
}

/** The power of ten that a value and its deviation are better told in; 0 for most. */
export function powerOf(sigma: number): number {
  if (!(sigma > 0) || !Number.isFinite(sigma)) return 0;
  const size = Math.floor(Math.log10(sigma));
  return size < -5 || size > 4 ? Math.ceil((size + 1) / 3) * 3 : 0;
}

export function powerOfTen(exponent: number): string {
  return exponent === 0 ? "" : `10${raised(exponent)}`;
}

/** A value and its deviation with the same decimals. */
export function withSigma(value: number, sigma: number, decimals = decimalsOf(sigma)): [string, string] {
  if (decimals === undefined) return [plain(value), plain(sigma, 2)];
  return [signed(value.toFixed(decimals)), sigma.toFixed(decimals)];
}

/** So many significant digits, without a deviation that would say how many are true. */
export function plain(value: number, digits = 5): string {
  if (!Number.isFinite(value)) return String(value);
  const size = Math.abs(value);
  if (value !== 0 && (size < 1e-4 || size >= 1e7)) {
    const [mantissa, exponent] = value.toExponential(digits - 1).split("e");
    return `${signed(mantissa ?? "")}·10${raised(Number(exponent))}`;
  }
  const decimals = Math.max(0, Math.min(9, digits - 1 - Math.floor(Math.log10(Math.max(size, 1e-4)))));
  return signed(value.toFixed(decimals));
}

function raised(exponent: number): string {
  const digits = "⁰¹²³⁴⁵⁶⁷⁸⁹";
  return String(exponent).replace("-", "⁻").replace(/\d/g, (digit) => digits[Number(digit)] ?? digit);
}

export function grouped(count: number): string {
  return count.toString().replace(/\B(?=(\d{3})+$)/g, "\u202f");
}

/** `name@sha256:…` without what nobody reads. */
export function modelName(id: string): string {
  return id.split("@")[0] ?? id;
}

/** How long ago, for people. */
export function ago(seconds: number): string {
  if (seconds < 60) return `${seconds < 1 ? seconds.toFixed(1) : Math.floor(seconds)} s ago`;
  return seconds < 3600 ? `${Math.floor(seconds / 60)} min ago` : `${Math.floor(seconds / 3600)} h ago`;
}
