// Numbers as scales and axes want them, and as they are typed. No DOM here.

/** A number of so many digits. @type {(value: number, digits?: number) => string} */
export const short = (value, digits = 3) => String(Number(value.toPrecision(digits)));

/** What is typed: a number, some, or null; undefined if it is none. @param {string} text */
export function typed(text) {
  const parts = text.split(","), values = parts.map(Number);
  if (!text.trim()) return null;
  if (!values.every(Number.isFinite) || parts.some((part) => !part.trim())) return undefined;
  return values.length > 1 ? values : values[0];
}

/**
 * Some `count` round numbers between two; 1, 2 and 5 of each decade on a long logarithmic axis.
 * @type {(low: number, high: number, count: number, log?: boolean) => number[]}
 */
export function rounds(low, high, count, log) {
  const found = [], parts = log && high / low > 10 ** (count / 2) ? [1] : [1, 2, 5];
  if (log && high / low > 8) {
    for (let ten = 10 ** Math.floor(Math.log10(low)); ten <= high; ten *= 10) {
      found.push(...parts.map((part) => part * ten));
    }
    return found.filter((one) => one >= low * 0.999 && one <= high * 1.001);
  }
  const least = (high - low) / count, power = 10 ** Math.floor(Math.log10(least));
  const step = power * [1, 2, 5, 10].find((part) => part * power >= least * 0.999);
  for (let i = Math.ceil(low / step - 1e-6); i * step <= high + 1e-6 * step; i++) {
    found.push(i * step);
  }
  return found;
}

/**
 * Where a value lies on an axis, 0 at its low end and 1 at its high one.
 * @type {(axis: {low: number, high: number, log?: boolean}, value: number) => number}
 */
export const share_of = ({ low, high, log }, value) =>
  (log ? Math.log(value / low) / Math.log(high / low) : (value - low) / (high - low));

/** Which a share of the known are below. @type {(values: ArrayLike, share: number) => number} */
export function percentile(values, share) {
  const known = Float32Array.from(values).filter((value) => value === value).sort();
  return known.length ? known[Math.floor(share * (known.length - 1))] : NaN;
}

/** Where colours end, [low, high]. @type {(kind: string, values: Float32Array) => number[]} */
export function ends_of(kind, values) {
  const [first, last] = [0.01, 0.99].map((share) => percentile(values, share));
  const low = Math.max(first, 1e-3 * last);
  if (kind === "log") return [low, Math.max(last, 1.01 * low)];
  const end = Math.max(1, percentile(values.map(Math.abs), 0.98));
  return kind === "signed" ? [-end, end] : [0, end];
}

/** How high a share of contrast that is explained stands: 1 for 90 %, 2 for 99 %. */
export const height_of = (explained) =>
  -Math.log10(Math.min(Math.max(1 - explained, 1e-4), 0.9));
