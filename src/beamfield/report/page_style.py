"""The style sheet of the page: dark on white, one column on a phone, fit for print."""

from __future__ import annotations

STYLE = """
:root { color-scheme: light; }
* { box-sizing: border-box; }
html { -webkit-text-size-adjust: 100%; scroll-behavior: smooth; }
body { margin: 0 auto; max-width: 1040px; padding: 1.5rem 1.25rem 4rem; background: #fff; color: #1b1f24;
  font: 16px/1.55 system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif; }
h1 { font-size: 1.75rem; line-height: 1.2; margin: 0 0 .3rem; overflow-wrap: anywhere; }
h2 { font-size: 1.25rem; line-height: 1.3; margin: 2.6rem 0 .7rem; padding-top: .5rem; border-top: 2px solid #1b1f24; }
h3 { font-size: 1rem; margin: 1.4rem 0 .4rem; }
p { margin: .5rem 0; max-width: 75ch; }
a { color: #005a9c; }
code, pre { font-family: ui-monospace, "SF Mono", Menlo, Consolas, "DejaVu Sans Mono", monospace; font-size: .86rem; }
p code { white-space: nowrap; }
pre { background: #f5f7f9; border: 1px solid #d8dee4; padding: .7rem .9rem; overflow-x: auto; line-height: 1.45; }
.facts { color: #47505a; margin: 0 0 1rem; max-width: none; overflow-wrap: anywhere; }
.verdict { font-size: 1.2rem; line-height: 1.45; border-left: 5px solid #0072b2; background: #eff6fb;
  padding: .8rem 1rem; margin: 1rem 0; max-width: none; }
.verdict.bad { border-color: #d55e00; background: #fdf3ec; }
nav { font-size: .9rem; margin: .8rem 0 0; }
nav a { margin-right: .9rem; white-space: nowrap; display: inline-block; }
ul.findings { list-style: none; margin: .8rem 0; padding: 0; }
ul.findings li { border-left: 5px solid #d55e00; background: #fdf3ec; padding: .55rem .9rem; margin: .5rem 0; }
ul.findings li.info { border-color: #9aa4ae; background: #f5f7f9; }
ul.findings code { color: #47505a; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; margin: .6rem 0; font-variant-numeric: tabular-nums; }
th, td { text-align: left; padding: .35rem .9rem .35rem 0; border-bottom: 1px solid #d8dee4; vertical-align: top; }
th { font-weight: 600; border-bottom: 1.5px solid #1b1f24; font-size: .9rem; }
td.n, th.n { text-align: right; white-space: nowrap; }
td.w { white-space: nowrap; }
td.hash { overflow-wrap: anywhere; }
tr.fit td { font-weight: 600; }
figure { margin: 0 0 2.4rem; }
figure h3 { font-size: 1.08rem; margin: 1.8rem 0 .5rem; }
.panels { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(100%, 400px), 1fr)); gap: 1rem 1.5rem; }
.panels .wide { grid-column: 1 / -1; overflow-x: auto; }
svg.plot, figure img { display: block; width: 100%; height: auto; }
svg.plot * { stroke-linejoin: round; stroke-linecap: butt; }
figcaption { font-size: .94rem; color: #30373e; max-width: 80ch; margin-top: .6rem; }
figcaption .source { color: #5b6570; }
details { margin: .6rem 0; }
summary { cursor: pointer; font-weight: 600; }
footer { margin-top: 3rem; color: #5b6570; font-size: .86rem; border-top: 1px solid #d8dee4; padding-top: .6rem; }
@media (max-width: 640px) {
  body { padding: 1rem .8rem 3rem; }
  h1 { font-size: 1.4rem; }
  .verdict { font-size: 1.08rem; }
  .panels .wide svg.plot, .panels .wide img { min-width: 600px; }
  td, th { padding-right: .6rem; }
  table.parameters thead { display: none; }
  table.parameters tr { display: flex; flex-wrap: wrap; column-gap: .8rem; border-bottom: 1px solid #d8dee4;
    padding: .45rem 0; }
  table.parameters td { border: 0; padding: 0; }
  table.parameters td.meaning { flex-basis: 100%; color: #47505a; font-size: .92rem; }
}
@media print {
  body { max-width: none; padding: 0; font-size: 10.5pt; }
  nav { display: none; }
  figure, table, pre, li { break-inside: avoid; }
  h2, h3 { break-after: avoid; }
  .panels { grid-template-columns: 1fr 1fr; }
}
"""
