// Words and numbers for people.

export const degrees = (radians) => 180 * radians / Math.PI;
export const wrapped = (angle) => Math.atan2(Math.sin(angle), Math.cos(angle));
export const minus = (text) => text.replace("-", "−");
export const signed = (value, n) => { const text = Math.abs(value).toFixed(n); return `${Number(text) === 0 ? "" : value < 0 ? "−" : "+"}${text}`; };
export const digits = (value) => (value === 0 ? "0" : Math.abs(value) < 1e-4 ? minus(value.toExponential(1)) : minus(String(Number(value.toPrecision(3)))));
export const largest = (values) => values.indexOf(Math.max(...values));
export const mean = (values) => values.reduce((sum, value) => sum + value, 0) / values.length;

// Where a slider stands, from 0 to 1, and back.
export function toShare({ low, high, logarithmic }, value) {
  return logarithmic ? Math.log(value / low) / Math.log(high / low) : (value - low) / (high - low);
}

export function toValue({ low, high, logarithmic }, share) {
  return Math.max(low, Math.min(high, logarithmic ? low * (high / low) ** share : low + share * (high - low)));
}

export function nearestTime(times, time) {
  let best = 0;
  times.forEach((value, i) => { if (Math.abs(value - time) < Math.abs(times[best] - time)) best = i; });
  return best;
}

// At most n of the indices that pass, spread over all of them.
export function spread(values, n, passes) {
  const all = [...values.keys()].filter((i) => passes(values[i]));
  if (all.length <= n) return all;
  return Array.from({ length: n }, (_, k) => all[Math.round(k * (all.length - 1) / (n - 1))]);
}
