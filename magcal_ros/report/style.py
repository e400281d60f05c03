"""The page's style sheet: one column on a phone, two on a desk, two sheets of A4 on paper."""

from __future__ import annotations

CSS = """
:root { color-scheme: light; --ink: #1c1f23; --soft: #5a626b; --line: #d9dde1; --pale: #f4f6f8; }
* { box-sizing: border-box; }
body { margin: 0 auto; max-width: 1080px; padding: 20px 16px 40px; background: #fff;
  color: var(--ink); font: 16px/1.5 system-ui, "Segoe UI", Roboto, Arial, sans-serif;
  overflow-wrap: anywhere; }
h1 { margin: 0; font-size: 1.7rem; line-height: 1.2; }
h2 { margin: 28px 0 10px; font-size: 1.15rem; }
h3 { margin: 0 0 4px; font-size: 1rem; }
p { margin: 0 0 8px; }
.meta { margin: 4px 0 16px; color: var(--soft); font-size: .9rem; }
.verdict { border: 1px solid var(--line); border-left: 8px solid; border-radius: 6px;
  padding: 12px 16px; background: var(--pale); }
.verdict p { margin: 8px 0 0; font-size: 1.05rem; }
.grades { display: flex; flex-wrap: wrap; gap: 8px; }
.grade { display: inline-block; border-radius: 4px; padding: 1px 9px; color: #fff;
  font-weight: 600; white-space: nowrap; }
.excellent { background: #00664b; } .good { background: #0072b2; }
.warn { background: #f0b323; color: #1c1f23; } .refused { background: #a3230d; }
.verdict.excellent, .verdict.good, .verdict.warn, .verdict.refused {
  background: var(--pale); color: inherit; }
.verdict.excellent { border-left-color: #00664b; } .verdict.good { border-left-color: #0072b2; }
.verdict.warn { border-left-color: #f0b323; } .verdict.refused { border-left-color: #a3230d; }
.key { display: grid; grid-template-columns: repeat(auto-fill, minmax(150px, 1fr)); gap: 8px;
  margin: 14px 0 0; }
.key div { border: 1px solid var(--line); border-radius: 6px; padding: 6px 10px; }
.key dt { color: var(--soft); font-size: .78rem; line-height: 1.3; }
.key dd { margin: 0; font-size: .95rem; font-weight: 600; font-variant-numeric: tabular-nums; }
.pictures { display: grid; grid-template-columns: repeat(2, minmax(0, 1fr)); gap: 18px;
  margin-top: 20px; }
figure { margin: 0; border: 1px solid var(--line); border-radius: 6px; padding: 12px; }
figure svg { display: block; width: 100%; height: auto; stroke-linejoin: round;
  stroke-linecap: butt; }
figure svg text { font-family: system-ui, "Segoe UI", Roboto, Arial, sans-serif !important; }
figcaption { margin-top: 6px; color: var(--soft); font-size: .86rem; line-height: 1.4; }
.missing { margin: 12px 0; border: 1px dashed #a9b0b7; border-radius: 6px; padding: 28px 14px;
  background: var(--pale); text-align: center; }
.scroll { overflow-x: auto; }
table { width: 100%; border-collapse: collapse; font-size: .9rem; }
th, td { border-bottom: 1px solid var(--line); padding: 4px 10px 4px 0; text-align: left;
  vertical-align: top; }
th { color: var(--soft); font-weight: 600; }
td.value { text-align: right; padding-right: 0; font-variant-numeric: tabular-nums; }
.checks td:nth-child(-n+2), .checks th { padding-right: 14px; white-space: nowrap; }
.numbers, .input { table-layout: fixed; }
.numbers td:first-child { width: 66%; } .input td:first-child { width: 38%; }
.twelve td { white-space: nowrap; font-variant-numeric: tabular-nums; }
.columns { display: grid; grid-template-columns: repeat(2, minmax(0, 1fr)); gap: 0 32px;
  align-items: start; }
ul { margin: 0; padding-left: 20px; }
code, pre { font: .82rem/1.45 ui-monospace, Menlo, Consolas, monospace; }
pre { margin: 0; border-radius: 6px; padding: 10px; background: var(--pale); overflow-x: auto;
  overflow-wrap: normal; }
@media screen and (max-width: 760px) {
  .pictures, .columns { grid-template-columns: minmax(0, 1fr); }
  .key { grid-template-columns: repeat(2, minmax(0, 1fr)); }
  .verdict p { font-size: 1rem; }
  .checks tr { display: block; border-bottom: 1px solid var(--line); padding: 6px 0; }
  .checks tr:first-child { display: none; }
  .checks td { display: inline-block; border: 0; padding-bottom: 0; }
  .checks td:last-child { display: block; }
}
@page { size: A4; margin: 10mm; }
@media print {
  * { print-color-adjust: exact; -webkit-print-color-adjust: exact; }
  body { max-width: none; padding: 0; font-size: 8pt; line-height: 1.3; }
  h1 { font-size: 14pt; } h2 { margin: 7pt 0 3pt; font-size: 9.5pt; } h3 { font-size: 8.5pt; }
  .meta { margin: 1pt 0 4pt; font-size: 7.5pt; display: -webkit-box; overflow: hidden;
    -webkit-box-orient: vertical; -webkit-line-clamp: 2; }
  .verdict { padding: 4pt 8pt; } .verdict p { margin-top: 3pt; font-size: 8pt; }
  .key { grid-template-columns: repeat(6, minmax(0, 1fr)); gap: 3pt; margin-top: 4pt; }
  .key div { padding: 1pt 4pt; } .key dt { font-size: 6pt; } .key dd { font-size: 8pt; }
  .pictures { grid-template-columns: repeat(2, minmax(0, 1fr)); gap: 4pt; margin-top: 5pt; }
  figure { padding: 4pt; break-inside: avoid; }
  figure svg { width: auto; max-width: 100%; height: 44mm; margin: 0 auto; }
  figcaption { margin-top: 1pt; font-size: 6.8pt; line-height: 1.2; }
  .missing { padding: 10pt; }
  h2 { break-after: avoid; }
  .columns { grid-template-columns: repeat(2, minmax(0, 1fr)); gap: 0 14pt; }
  table { font-size: 6.5pt; line-height: 1.15; } th, td { padding: .6pt 6pt .6pt 0; }
  .grade { padding: 0 4pt; } .checks .grade { font-size: 6.4pt; }
  tr { break-inside: avoid; }
  code, pre { font-size: 6pt; line-height: 1.15; }
  pre { padding: 3pt; white-space: pre-wrap; }
  .scroll, pre { overflow: visible; }
  #sensors.fine, #sensors details { display: none; }
}
"""
