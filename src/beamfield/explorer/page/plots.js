// The density of one reading, and curves over the time of the log.
import { CAUSES, sharp } from "./pictures.js";
import { digits } from "./words.js";

const FONT = "11px system-ui, sans-serif";

// Densities of a reading by one model or two; `densities` are what the server says of each.
export function drawDensity(canvas, densities, maxRange, colours) {
  const [{ measured, expected }] = densities, end = Math.min(maxRange, 1 + 1.5 * Math.max(measured ?? 0, expected));
  const context = sharp(canvas), { clientWidth: width, clientHeight: height } = canvas, bottom = height - 18;
  context.clearRect(0, 0, width, height);
  const shown = densities.filter((one) => one.curves);
  if (!shown.length) return;
  const totals = shown.map(({ ranges, curves }) => ranges.map((_, k) => curves.hit[k] + curves.short[k] + curves.rand[k])), all = totals.flat();
  const low = Math.log10(Math.max(1e-4, Math.min(...all) / 2)), high = Math.log10(Math.max(...all) * 1.5);
  const toX = (range) => 4 + (width - 8) * range / end;
  const toY = (value) => Math.min(bottom + 2, bottom - (bottom - 6) * (Math.log10(Math.max(value, 1e-12)) - low) / (high - low));
  const curve = (ranges, values, colour, thick, dash = []) => {
    context.strokeStyle = colour; context.lineWidth = thick; context.setLineDash(dash); context.beginPath();
    values.forEach((value, k) => { if (k) context.lineTo(toX(ranges[k]), toY(value)); else context.moveTo(toX(ranges[k]), toY(value)); });
    context.stroke(); context.setLineDash([]);
  };
  const [first] = shown;
  context.save(); context.beginPath(); context.rect(0, 0, width, bottom + 2); context.clip();
  for (const name of ["short", "rand", "hit"]) curve(first.ranges, first.curves[name], colours[name], 1);
  curve(first.ranges, totals[0], colours.ink, 2);
  if (shown.length > 1) curve(shown[1].ranges, totals[1], colours.accent, 2, [7, 4]);
  if (first.measured !== null) curve([first.measured, first.measured], [10 ** high, 10 ** low], colours.quiet, 1.5, [2, 3]);
  context.restore();
  context.fillStyle = colours.quiet; context.font = FONT; context.textAlign = "left";
  context.fillText("0", 4, height - 4); context.textAlign = "right"; context.fillText(`${end.toFixed(1)} m`, width - 4, height - 4);
  context.textAlign = "center";
  context.fillText(`log density; dotted: measured${shown.length > 1 ? "; dashed: B" : ""}`, width / 2, height - 4);
}

export function densityWords(beam, densities, letters) {
  const [{ measured, expected }] = densities;
  const parts = [`Reading ${beam}: ${measured === null ? "no measurement" : `measured ${measured.toFixed(2)} m`}, expected ${expected.toFixed(2)} m.`];
  densities.forEach((one, k) => {
    const of = letters ? `${letters[k]}: ` : "";
    if (!one.curves) parts.push(`${of}Only a beam model has a density of the range.`);
    else if (one.shares.some((share) => share > 0)) parts.push(`${of}Causes: ${CAUSES.map((name, c) => `${name} ${Math.round(100 * one.shares[c])}%`).join(", ")}.`);
  });
  return parts.join(" ");
}

// Values over the time of the log: a line, or bars up and down from 0 for differences. Returns what a screen reader says.
export function drawCurve(canvas, { name, values, times, i, isDifference, level }, colours) {
  const context = sharp(canvas), { clientWidth: width, clientHeight: height } = canvas, end = times.at(-1) || 1, bottom = height - 14;
  context.clearRect(0, 0, width, height);
  const known = values.filter((value) => value !== null && value !== undefined);
  const bounds = [...known, ...(isDifference ? [0] : []), ...(level === undefined ? [] : [level])];
  const low = Math.min(...bounds), high = Math.max(...bounds);
  const toX = (k) => 1 + (width - 2) * times[k] / end, toY = (value) => bottom - 3 - (bottom - 6) * (high > low ? (value - low) / (high - low) : 0.5);
  const line = (colour, thick, points, dash = []) => {
    context.strokeStyle = colour; context.lineWidth = thick; context.setLineDash(dash); context.beginPath();
    let drawing = false;
    for (const point of points) {
      if (!point) { drawing = false; continue; }
      if (drawing) context.lineTo(...point); else context.moveTo(...point);
      drawing = true;
    }
    context.stroke(); context.setLineDash([]);
  };
  if (known.length) {
    if (level !== undefined) line(colours.quiet, 1, [[0, toY(level)], [width, toY(level)]], [4, 4]);
    if (isDifference) {
      values.forEach((value, k) => { if (value) line(value > 0 ? colours.hit : colours.short, 2, [[toX(k), toY(0)], [toX(k), toY(value)]]); });
      line(colours.quiet, 1, [[0, toY(0)], [width, toY(0)]]);
    } else line(colours.hit, 1.5, values.map((value, k) => (value === null ? null : [toX(k), toY(value)])));
  }
  line(colours.ink, 2, [[toX(i), 0], [toX(i), bottom]]);
  context.font = FONT;
  const label = (text, x, y, align) => {
    context.textAlign = align;
    const wide = context.measureText(text).width + 4;
    context.globalAlpha = 0.8; context.fillStyle = colours.panel; context.fillRect(align === "left" ? x - 2 : x - wide + 2, y - 10, wide, 13); context.globalAlpha = 1;
    context.fillStyle = colours.quiet; context.fillText(text, x, y);
  };
  if (known.length) { label(digits(high), 2, 11, "left"); label(digits(low), 2, bottom - 3, "left"); }
  label("0 s", 2, height - 2, "left"); label(`${end.toFixed(0)} s`, width - 2, height - 2, "right");
  const now = values[i] ?? null;
  return `Timeline of ${name}: ${now === null ? "no value" : digits(now)} now${known.length ? `, from ${digits(low)} to ${digits(high)}` : ""}`;
}
