"""The style sheet of the pages: light or dark as the reader's system, fit for wide screens, phones and print."""

from __future__ import annotations

# Figures keep white paper in the dark: their colours mean causes, and captions name them.
STYLE = """
:root { color-scheme: light dark; --ink: #1b1f24; --soft: #4a545e; --paper: #fff; --line: #d8dee4; --box: #f5f7f9;
  --link: #005a9c; --good: #00664b; --good-box: #ebf7f2; --care: #a34700; --care-box: #fdf3e7; --bad: #b3132b;
  --bad-box: #fdecee; --note: #0068a5; --note-box: #eff6fb; }
@media screen and (prefers-color-scheme: dark) {
  :root { --ink: #e4e8ec; --soft: #a9b4be; --paper: #14181c; --line: #39424b; --box: #1d2329; --link: #7cc0f2;
    --good: #4cc9a0; --good-box: #12291f; --care: #f0a04b; --care-box: #2d2114; --bad: #ff7d8e; --bad-box: #331a1e;
    --note: #6db7ea; --note-box: #14242f; }
}
* { box-sizing: border-box; }
html { -webkit-text-size-adjust: 100%; scroll-behavior: smooth; scroll-padding-top: 3.2rem; }
body { margin: 0 auto; max-width: 1080px; padding: 0 1.25rem 4rem; background: var(--paper); color: var(--ink);
  font: 16px/1.55 system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif; }
h1 { font-size: 1.75rem; line-height: 1.2; margin: 1.2rem 0 .3rem; overflow-wrap: anywhere; }
h2 { font-size: 1.25rem; line-height: 1.3; margin: 2.6rem 0 .7rem; padding-top: .5rem;
  border-top: 2px solid var(--ink); }
h3 { font-size: 1rem; margin: 1.4rem 0 .4rem; }
p { margin: .5rem 0; max-width: 75ch; }
a { color: var(--link); }
code, pre, table.parameters tbody th { font-size: .86rem;
  font-family: ui-monospace, "SF Mono", Menlo, Consolas, "DejaVu Sans Mono", monospace; }
code { white-space: nowrap; }
pre { background: var(--box); border: 1px solid var(--line); padding: .7rem .9rem; overflow-x: auto;
  line-height: 1.45; }
.skip { position: absolute; left: -100vw; }
.skip:focus { left: 1rem; top: .5rem; z-index: 2; padding: .4rem .8rem; background: var(--paper); }
.facts, .key { color: var(--soft); margin: 0 0 1rem; max-width: none; overflow-wrap: anywhere; }
.key { font-size: .9rem; }
.verdict, ul.findings li { border-left: 5px solid; padding: .7rem 1rem; margin: 1rem 0; max-width: none; }
.verdict { font-size: 1.2rem; line-height: 1.45; }
.label { text-transform: uppercase; letter-spacing: .04em; font-size: .8em; margin-right: .35em; }
ul.findings { list-style: none; margin: .8rem 0; padding: 0; }
ul.findings li { margin: .5rem 0; }
ul.findings p { margin: .2rem 0; max-width: none; }
ul.findings code { color: var(--soft); }
.good { border-color: var(--good) !important; background: var(--good-box); }
.care, .warning { border-color: var(--care) !important; background: var(--care-box); }
.bad, .error { border-color: var(--bad) !important; background: var(--bad-box); }
.info { border-color: var(--note) !important; background: var(--note-box); }
.good .label { color: var(--good); }
.care .label, .warning .label { color: var(--care); }
.bad .label, .error .label { color: var(--bad); }
.info .label { color: var(--note); }
nav { position: sticky; top: 0; z-index: 1; background: var(--paper); border-bottom: 1px solid var(--line);
  font-size: .9rem; overflow-x: auto; }
nav ul { display: flex; list-style: none; gap: .2rem 1.1rem; margin: 0; padding: .55rem 0; white-space: nowrap; }
nav .more { display: none; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; margin: .6rem 0; font-variant-numeric: tabular-nums; }
th, td { text-align: left; padding: .35rem .9rem .35rem 0; border-bottom: 1px solid var(--line); vertical-align: top; }
thead th { font-weight: 600; border-bottom: 1.5px solid var(--ink); font-size: .9rem; }
tbody th { font-weight: 400; }
.n { text-align: right; white-space: nowrap; }
table.parameters td:nth-child(3), table.origin th { white-space: nowrap; }
table.origin td { overflow-wrap: anywhere; }
tr.fit > * { font-weight: 600; }
figure { margin: 0 0 2.4rem; }
figure h3 { font-size: 1.08rem; margin: 1.8rem 0 .5rem; }
.panels { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(100%, 400px), 1fr)); gap: 1rem 1.5rem; }
.panels .wide { grid-column: 1 / -1; overflow-x: auto; }
svg.plot, figure img { display: block; width: 100%; height: auto; background: #fff; border-radius: 4px; }
svg.plot * { stroke-linejoin: round; stroke-linecap: butt; }
figcaption { font-size: .94rem; max-width: 80ch; margin-top: .6rem; }
figcaption .source, footer { color: var(--soft); }
details { margin: .6rem 0; }
summary { cursor: pointer; font-weight: 600; }
footer { margin-top: 3rem; font-size: .86rem; border-top: 1px solid var(--line); padding-top: .6rem; }
@media (min-width: 1340px) {
  body { max-width: 1300px; display: grid; grid-template-columns: 12.5rem minmax(0, 1fr); gap: 0 2.5rem; }
  nav { align-self: start; max-height: 100vh; overflow-y: auto; border: 0; padding-top: 1rem; }
  nav ul { flex-direction: column; white-space: normal; }
  nav .more { display: block; font-size: .85rem; line-height: 1.3; padding-left: .8rem; }
}
@media (max-width: 640px) {
  body { padding: 0 .8rem 3rem; }
  h1 { font-size: 1.4rem; }
  .verdict { font-size: 1.08rem; }
  .panels .wide svg.plot, .panels .wide img { width: 720px; }
  td, th { padding-right: .6rem; }
  table.parameters thead { display: none; }
  table.parameters tr { display: flex; flex-wrap: wrap; column-gap: .8rem; border-bottom: 1px solid var(--line);
    padding: .45rem 0; }
  table.parameters tbody > tr > * { border: 0; padding: 0; }
  table.parameters td:last-child { flex-basis: 100%; color: var(--soft); font-size: .92rem; }
}
@media print {
  :root { color-scheme: light; }
  body { max-width: none; padding: 0; font-size: 10.5pt; display: block; }
  nav, .skip { display: none; }
  figure, table, pre, li { break-inside: avoid; }
  h2, h3 { break-after: avoid; }
  .panels { grid-template-columns: 1fr 1fr; }
}
"""
