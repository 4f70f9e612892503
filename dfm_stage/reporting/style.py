"""The style sheet of every page: phone, desk and print, light and dark."""

STYLE = """\
:root {
  color-scheme: light dark;
  --paper: #fcfcfa; --ink: #1c2024; --soft: #5d666f; --grid: #dfe2e4; --panel: #f2f3f1;
  --c1: #0b62a8; --c2: #c2410c; --c3: #0f766e; --c4: #9d2b7c; --c5: #7a5c00; --c6: #4b5563;
  --good: #166534; --bad: #b42318; --warn: #8a5a00;
}
@media (prefers-color-scheme: dark) {
  :root {
    --paper: #14171a; --ink: #e8eaec; --soft: #a3acb5; --grid: #343a40; --panel: #1e2226;
    --c1: #6db3f2; --c2: #fb9a5b; --c3: #4fd1b8; --c4: #ef8fd0; --c5: #dfc04d; --c6: #b6bec7;
    --good: #6fd08c; --bad: #ff8a7d; --warn: #e5b454;
  }
}
* { box-sizing: border-box; }
html { -webkit-text-size-adjust: 100%; }
body {
  margin: 0 auto; padding: 2.5rem 1.25rem 3rem; max-width: 60rem;
  background: var(--paper); color: var(--ink);
  font: 1rem/1.55 system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", sans-serif;
  overflow-wrap: break-word;
}
h1 { font-size: 1.9rem; line-height: 1.2; margin: 0 0 .6rem; letter-spacing: -.01em; }
h2 { font-size: 1.25rem; line-height: 1.3; margin: 2.6rem 0 .5rem; }
p { margin: .5rem 0; max-width: 44rem; }
.lead { font-size: 1.15rem; line-height: 1.5; margin: 0 0 1.2rem; }
.badge {
  display: inline-block; margin: 0 .55rem 0 0; padding: .05rem .6rem; border: 1.5px solid;
  border-radius: 1rem; font-size: .9rem; font-weight: 600; vertical-align: .08em;
}
.good { color: var(--good); } .bad { color: var(--bad); } .warn { color: var(--warn); }
.note { border-left: 3px solid var(--warn); padding: .1rem 0 .1rem .9rem; }
figure { margin: 1.2rem 0 1.6rem; }
figcaption, caption { color: var(--soft); font-size: .92rem; text-align: left; }
figcaption { margin-top: .4rem; max-width: 44rem; }
caption { padding: 0 0 .4rem; caption-side: top; }
nav ol { display: flex; flex-wrap: wrap; gap: .2rem 1.1rem; margin: 0 0 1.4rem; padding: 0; }
nav li { list-style: none; }
a { color: var(--c1); text-underline-offset: .2em; text-decoration-color: var(--grid); }
a:hover { text-decoration-color: currentColor; }
a:focus-visible { outline: 2px solid var(--c1); outline-offset: 3px; }
nav a { font-size: .92rem; }
.csv { white-space: nowrap; margin-left: .5em; }
.plot svg { display: block; width: 100%; height: auto; }
.plot.narrow { display: none; }
.plot { position: relative; }
.plot.live svg {
  cursor: crosshair; touch-action: pan-y pinch-zoom; -webkit-user-select: none; user-select: none;
}
.plot svg:focus-visible { outline: 2px solid var(--c1); outline-offset: 3px; }
.cross { pointer-events: none; stroke: var(--soft); stroke-width: .8; }
.cross circle { fill: var(--paper); stroke-width: 1.6; }
.cross rect { fill: var(--c1); fill-opacity: .14; stroke: none; }
.zoomed text { stroke: var(--paper); stroke-width: 3px; paint-order: stroke; }
.readout {
  position: absolute; max-width: calc(50% - 1rem); padding: .25rem .55rem; pointer-events: none;
  background: var(--paper); border: 1px solid var(--grid); border-radius: .3rem;
  font-size: .82rem; line-height: 1.4; font-variant-numeric: tabular-nums; color: var(--soft);
}
.readout:empty { display: none; }
.readout b { color: var(--ink); font-weight: 600; }
.readout i {
  display: inline-block; width: .6rem; height: .6rem; margin-right: .4rem; border-radius: 50%;
}
.scroll { overflow-x: auto; margin: .8rem 0 1.2rem; }
table {
  min-width: min(100%, 17rem); border-collapse: collapse; font-size: .94rem;
  font-variant-numeric: tabular-nums;
}
th, td { padding: .32rem 1.1rem .32rem 0; text-align: left; vertical-align: top; }
th { color: var(--soft); font-weight: 600; border-bottom: 1.5px solid var(--grid); }
td { border-bottom: 1px solid var(--grid); }
td.number { white-space: nowrap; }
td.number, th.number { text-align: right; }
td:last-child, th:last-child { padding-right: 0; }
details { margin: .5rem 0; }
summary { cursor: pointer; color: var(--soft); font-size: .92rem; width: fit-content; }
summary:focus-visible { outline: 2px solid var(--c1); outline-offset: 3px; }
footer {
  margin-top: 3rem; padding-top: .9rem; border-top: 1.5px solid var(--grid);
  color: var(--soft); font-size: .88rem;
}
footer dl { display: grid; grid-template-columns: max-content 1fr; gap: .15rem 1.2rem; margin: 0; }
footer dt { font-weight: 600; }
footer dd { margin: 0; overflow-wrap: anywhere; }
@media (max-width: 40rem) {
  body { padding: 1.4rem 1rem 2rem; }
  h1 { font-size: 1.5rem; }
  .plot.wide { display: none; }
  .plot.narrow { display: block; }
  table { font-size: .84rem; }
  th, td { padding-right: .5rem; }
  caption { max-width: calc(100vw - 2rem); }
  .cards, .cards caption, .cards tbody, .cards tr, .cards td { display: block; }
  .cards thead { display: none; }
  .cards tr { padding: .5rem 0; border-bottom: 1px solid var(--grid); }
  .cards td, .cards td.number {
    display: grid; grid-template-columns: 6.5rem 1fr; padding: .1rem 0; border: 0;
    text-align: left; white-space: normal;
  }
  .cards td::before { content: attr(data-head); color: var(--soft); }
  footer dl { grid-template-columns: 1fr; gap: 0; }
  footer dd { margin-bottom: .4rem; }
}
@media screen and (min-width: 75rem) {
  body {
    max-width: 96rem; padding: 2.5rem 2.5rem 3rem; display: grid; column-gap: 3rem;
    grid-template: auto auto auto / 11.5rem minmax(0, 1fr);
  }
  h1, main, footer { grid-column: 2; }
  body:not(:has(nav)) { grid-template-columns: 0 minmax(0, 1fr); column-gap: 0; }
  nav { grid-column: 1; grid-row: 1 / span 3; }
  nav ol { position: sticky; top: 2.5rem; display: block; margin-top: .7rem; }
  nav li { margin: 0 0 .55rem; line-height: 1.35; }
  nav a { color: var(--soft); text-decoration: none; }
  nav a:hover { color: var(--ink); }
  .lead { max-width: 56rem; }
  .row { display: flex; flex-wrap: wrap; column-gap: 3.5rem; }
  .row > p { flex-basis: 100%; max-width: 56rem; }
  .row > .scroll { max-width: 100%; }
  .row > .texts { flex: 1 1 24rem; max-width: 40rem; margin: .6rem 0; }
  .with-figure {
    display: grid; grid-template: auto auto auto 1fr / minmax(0, 11fr) minmax(0, 9fr);
    column-gap: 2.5rem; margin: 0 0 1.6rem;
  }
  .with-figure figure { display: contents; }
  .drawn { grid-column: 1; grid-row: 1 / span 4; }
  .before, .with-figure details, .after { grid-column: 2; }
  .before { grid-row: 1; } .with-figure details { grid-row: 2; } .after { grid-row: 3; }
  .before p:first-child { margin-top: 0; }
  .with-figure details::details-content { content-visibility: visible; block-size: auto; }
  .with-figure summary { list-style: none; cursor: default; pointer-events: none; }
  .with-figure summary::-webkit-details-marker { display: none; }
  .with-figure table { font-size: .86rem; }
  .with-figure th, .with-figure td { padding-right: .8rem; }
  .with-figure .many { font-size: .78rem; }
  .with-figure .many th, .with-figure .many td { padding-right: .4rem; }
  .with-figure details .scroll { max-height: 30rem; overflow: auto; margin-top: .3rem; }
}
@media print {
  :root {
    color-scheme: light;
    --paper: #fff; --ink: #000; --soft: #444; --grid: #ccc; --panel: #fff;
    --c1: #0b62a8; --c2: #c2410c; --c3: #0f766e; --c4: #9d2b7c; --c5: #7a5c00; --c6: #4b5563;
    --good: #166534; --bad: #b42318; --warn: #8a5a00;
  }
  body { padding: 0; max-width: none; font-size: 10.5pt; }
  figure, tr { break-inside: avoid; }
  h2 { break-after: avoid; }
  .plot.wide { display: block; }
  .plot.narrow { display: none; }
  .scroll { overflow: visible; }
  .cross, .readout { display: none; }
}
"""
