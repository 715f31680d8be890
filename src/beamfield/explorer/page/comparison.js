// Which of two models explains scans better, along the log.
import { mean, signed, spread } from "./words.js";

const SCANS = 240, TOGETHER = 20, WAIT_MS = 500;
export const POSE = "A − B: pose score [nats]", READING = "A − B: log likelihood of a reading [nats]";

export class Comparison {
  // `explorer` sends messages; `changed` is called when there is more to show.
  constructor(explorer, changed) { Object.assign(this, { explorer, changed, run: 0, curves: {} }); }

  // Begin anew, in a moment: sliders move on.
  restart() {
    const run = ++this.run, { explorer } = this;
    clearTimeout(this.timer);
    this.curves = {};
    const scans = spread(explorer.start.poses, SCANS, Boolean);
    if (explorer.other === null || !scans.length) return;
    const sets = [explorer.set, explorer.other], densities = sets.every((k) => explorer.start.sets[k].kind === "beam");
    for (const name of densities ? [POSE, READING] : [POSE]) this.curves[name] = Array(explorer.start.times.length).fill(null);
    this.timer = setTimeout(() => this.next(run, sets, scans), WAIT_MS);
  }

  next(run, sets, scans) {
    if (run !== this.run || !scans.length) return;
    const now = scans.slice(0, TOGETHER);
    this.explorer.latest.send(this.explorer.message("scores", { scans: now, sets }), ({ scores }) => {
      if (run !== this.run) return;
      scores.forEach((score, k) => { if (score) this.note(now[k], score); });
      this.changed();
      this.next(run, sets, scans.slice(TOGETHER));
    }, { kind: "comparison" });
  }

  note(i, { pose, reading }) {
    this.curves[POSE][i] = pose[0] - pose[1];
    if (this.curves[READING] && reading[0] !== null && reading[1] !== null) this.curves[READING][i] = reading[0] - reading[1];
  }

  // In words: this scan by the scores of all sets, and the log as far as it was looked at.
  words(scores) {
    const { explorer } = this;
    if (explorer.other === null) return "";
    const parts = [];
    if (scores) {
      const of = (values) => values[explorer.set] - values[explorer.other];
      parts.push(`This scan: pose score ${better(of(scores.pose))}`);
      if (this.curves[READING] && scores.reading[explorer.set] !== null && scores.reading[explorer.other] !== null) parts.push(`, a reading ${better(of(scores.reading), 2)}`);
      parts.push(". ");
    }
    const along = (this.curves[POSE] ?? []).filter((value) => value !== null);
    if (along.length) {
      const wins = along.filter((value) => value > 0).length;
      parts.push(`Over ${along.length} scan${along.length > 1 ? "s" : ""} of the log: A better in ${Math.round(100 * wins / along.length)}%; A − B is ${signed(mean(along), 2)} nats in the mean.`);
    }
    return parts.join("");
  }
}

const better = (difference, n = 1) => (Math.abs(difference) < 0.5 * 10 ** -n ? "alike" : `${difference > 0 ? "A" : "B"} better by ${Math.abs(difference).toFixed(n)} nats`);
