"""The style of the report's page: light, dark, narrow and printed."""

STYLE = """
:root { --paper: #fff; --ink: #1b1f24; --soft: #5b6570; --rule: #d9dee3; --grid: #e6eaee; --panel: #f6f8fa;
  --bad: #b3261e; --flown: #0072b2; --plan: #c25400;
  --c0: #0072b2; --c1: #c25400; --c2: #00805c; --c3: #a83e7d; --c4: #9a6b00;
  --c5: #2f8fc4; --c6: #7a4b1e; --c7: #6a3fb5 }
@media screen and (prefers-color-scheme: dark) {
  :root { --paper: #14181c; --ink: #e4e8ec; --soft: #9aa5b0; --rule: #343c44; --grid: #2a3138; --panel: #1b2127;
    --bad: #ff8a80; --flown: #56b4e9; --plan: #f0a04b;
    --c0: #56b4e9; --c1: #f0a04b; --c2: #3fc79a; --c3: #e08fc0; --c4: #e0c04b;
    --c5: #9fd3f2; --c6: #c99a6b; --c7: #b79bf0 }
}
* { box-sizing: border-box }
html { -webkit-text-size-adjust: 100% }
body { margin: 0 auto; padding: 1.5rem clamp(.75rem, 3vw, 2rem) 3rem; max-width: 1400px; background: var(--paper);
  color: var(--ink); font: 15px/1.45 system-ui, "Segoe UI", "Helvetica Neue", Arial, sans-serif }
h1 { font-size: 1.7rem; margin: 0; overflow-wrap: anywhere }
h2 { font-size: 1.25rem; margin: 2.2rem 0 .6rem; padding-bottom: .2rem; border-bottom: 2px solid var(--rule);
  overflow-wrap: anywhere }
h3 { font-size: 1rem; margin: 1.4rem 0 .4rem }
h4 { font-size: .9rem; margin: 1rem 0 .3rem; color: var(--soft) }
p { margin: .3rem 0; overflow-wrap: anywhere }
header p, .none, figcaption { color: var(--soft) }
nav { display: flex; flex-wrap: wrap; gap: .4rem; margin: .8rem 0 0 }
nav a { padding: .15rem .6rem; border: 1px solid var(--rule); border-radius: 1rem; color: inherit;
  text-decoration: none }
ul { margin: .3rem 0; padding-left: 1.2rem }
li { overflow-wrap: anywhere }
table { border-collapse: collapse; font-size: .875rem; font-variant-numeric: tabular-nums }
th { text-align: left; font-weight: 600; color: var(--soft); vertical-align: bottom }
th, td { padding: .25rem .8rem .25rem 0; border-bottom: 1px solid var(--rule) }
td { vertical-align: top; overflow-wrap: break-word; max-width: 40rem }
td.long { overflow-wrap: anywhere; min-width: 6rem }
td:first-child { font-weight: 600 }
th.number, td.number { text-align: right }
td.number { white-space: nowrap }
tr.bad td:first-child, tr.bad td:last-child { color: var(--bad) }
.scrolled { max-height: 26rem; overflow: auto }
.scrolled th { position: sticky; top: 0; background: var(--paper) }
table.events td:first-child { font-weight: 400; white-space: nowrap }
article { break-inside: avoid }
figure { margin: 0; min-width: 0; break-inside: avoid }
figcaption { font-size: .8rem; margin-top: .2rem }
.drawings { margin-top: .6rem; display: grid;
  grid-template-columns: repeat(auto-fit, minmax(min(100%, 270px), 1fr)); gap: 1rem;
  align-items: start }
.drawings figure { max-width: 460px }
.overview { max-width: 560px; margin-top: 1.2rem }
.origin { white-space: nowrap }
svg { display: block; width: 100%; height: auto; background: var(--panel); border-radius: 4px }
svg text { font: 11px system-ui, "Segoe UI", Arial, sans-serif; fill: var(--soft) }
svg text.x { text-anchor: middle }
svg text.y { text-anchor: end }
svg .grid { stroke: var(--grid); stroke-width: 1 }
svg path { fill: none; stroke-width: 1.8; stroke-linejoin: round; stroke-linecap: round }
path.flown { stroke: var(--flown) }
path.plan { stroke: var(--plan); stroke-dasharray: 6 4 }
circle.first { fill: var(--panel); stroke: var(--flown); stroke-width: 2 }
rect.last { fill: var(--flown) }
path.c0 { stroke: var(--c0) } path.c1 { stroke: var(--c1) } path.c2 { stroke: var(--c2) } path.c3 { stroke: var(--c3) }
path.c4 { stroke: var(--c4) } path.c5 { stroke: var(--c5) } path.c6 { stroke: var(--c6) } path.c7 { stroke: var(--c7) }
.key { white-space: nowrap; color: var(--ink) }
.key::before { content: ""; display: inline-block; width: 1.4em; margin: 0 .3em .25em 0;
  border-top: 3px solid currentColor }
.key.flown::before { border-color: var(--flown) }
.key.plan::before { border-top: 3px dashed var(--plan) }
.key.c0::before { border-color: var(--c0) } .key.c1::before { border-color: var(--c1) }
.key.c2::before { border-color: var(--c2) } .key.c3::before { border-color: var(--c3) }
.key.c4::before { border-color: var(--c4) } .key.c5::before { border-color: var(--c5) }
.key.c6::before { border-color: var(--c6) } .key.c7::before { border-color: var(--c7) }
@media screen and (max-width: 700px) {
  table.figures, table.figures tbody { display: block }
  table.figures thead { display: none }
  table.figures tr { display: grid; grid-template-columns: 1fr 1fr; column-gap: 1.5rem; padding: .4rem 0;
    border-bottom: 1px solid var(--rule) }
  table.figures td, table.figures td.number { display: flex; justify-content: space-between; gap: .6rem; border: 0;
    padding: .05rem 0; text-align: right; max-width: none; min-width: 0 }
  table.figures td::before { content: attr(data-head); color: var(--soft); font-weight: 400; text-align: left;
    white-space: nowrap }
  table.figures td.none { display: none }
  table.figures td:first-child, table.figures td.long { grid-column: 1 / -1 }
  table.figures td:first-child { display: block; text-align: left }
  table.figures td:first-child::before { content: none }
  table.events, table.small { width: 100% }
  th, td { padding-right: .5rem }
}
@media print {
  body { max-width: none; padding: 0; font-size: 10pt }
  nav { display: none }
  table { font-size: .72rem }
  th, td { padding-right: .5rem }
  .scrolled { max-height: none; overflow: visible }
  .drawings { grid-template-columns: repeat(3, 1fr) }
  section { break-before: auto }
  h2, h3, h4 { break-after: avoid }
  tr { break-inside: avoid }
  svg { background: none; border: 1px solid var(--rule) }
}
"""
