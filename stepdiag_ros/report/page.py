"""The frame of every page: one self-contained HTML file, nothing fetched, prints well."""

from html import escape

STYLE = """
:root{--ink:#22282e;--soft:#6b747c;--rule:#e1e5e8;--paper:#fff;--back:#f4f5f6;--before:#c2572f;--after:#17688a;
--good:#2b7a4b;--warn:#b97a12;--bad:#b3362a;--tint:#eef3f5}
*{box-sizing:border-box}
body{margin:0;background:var(--back);color:var(--ink);font:15px/1.5 system-ui,"Segoe UI",Helvetica,Arial,sans-serif}
main{max-width:1180px;margin:0 auto;background:var(--paper);padding:34px 44px 50px;box-shadow:0 0 0 1px var(--rule)}
header .kicker{color:var(--soft);font-size:13px;letter-spacing:.02em}
h1{font-size:25px;line-height:1.28;margin:10px 0 8px;font-weight:650;max-width:36em}
h2{font-size:18px;margin:40px 0 6px;padding-top:14px;border-top:1px solid var(--rule);font-weight:650}
h3{font-size:15px;margin:18px 0 4px}
p{margin:6px 0;max-width:62em}
.lead{font-size:16.5px;color:#39424a}
.soft,small{color:var(--soft)}
small{font-size:12.5px}
.badge{display:inline-block;border-radius:3px;padding:2px 10px;font-size:13px;font-weight:650;color:#fff}
.good{background:var(--good)}.warn{background:var(--warn)}.bad{background:var(--bad)}
table{border-collapse:collapse;margin:8px 0;font-size:14px}
th{font-weight:600;text-align:left;color:var(--soft);font-size:12.5px;
border-bottom:1px solid var(--rule);padding:5px 14px 5px 0}
td{border-bottom:1px solid var(--rule);padding:7px 14px 7px 0;vertical-align:top}
td.n,th.n{text-align:right;font-variant-numeric:tabular-nums}
.nums td{padding:1px 12px 1px 0;border:0;font-variant-numeric:tabular-nums;white-space:nowrap}
.nums{margin:0}
.heat{font-size:13px}
.heat td{border:2px solid #fff;padding:6px 4px;text-align:center;min-width:52px;font-variant-numeric:tabular-nums}
.heat th{border:0;padding:4px 6px;text-align:center}.heat th.r{text-align:right;white-space:nowrap}
.cols{display:grid;grid-template-columns:minmax(0,1.15fr) minmax(0,1fr);gap:44px}
.bars{display:grid;grid-template-columns:max-content 1fr max-content;gap:4px 12px;
align-items:center;font-size:14px;margin:8px 0}
.sides .bars{grid-template-columns:17.5em 1fr 3.5em}
.bars .b{background:var(--tint);height:13px;border-radius:2px}
.bars .b i{display:block;height:100%;background:var(--after);border-radius:2px;min-width:1px}
.bars .v{font-variant-numeric:tabular-nums;text-align:right}
.todo{border-left:4px solid var(--after);background:var(--tint);padding:10px 16px;margin:12px 0;max-width:60em}
.todo.warn2{border-color:var(--warn);background:#fbf5e8}
figure{margin:10px 0 4px}figure>svg,svg.panels{width:100%;height:auto;display:block}
.scroll{overflow-x:auto}
.multiples{display:grid;grid-template-columns:repeat(auto-fill,minmax(min(var(--least),100%),1fr));gap:4px 12px}
.panels text{stroke:none;fill:currentColor;font-variant-numeric:tabular-nums}
.legend{display:flex;flex-wrap:wrap;gap:2px 18px;font-size:13px;color:var(--soft);margin:2px 0 6px}
.legend svg{vertical-align:-1px;margin-right:5px}
path.before,text.before{color:var(--before)}path.after,text.after{color:var(--after)}path.real,text.ink{color:var(--ink)}
path.noise{color:#dfe5e9}path.grid{color:#e4e7ea;stroke-width:.7}path.axis{color:#aab2b8;stroke-width:.8}
text.title{font-weight:600}path.soft,text.soft{color:var(--soft)}path.faint{opacity:.5}
figcaption{color:var(--soft);font-size:13px;max-width:70em;margin-top:4px}
details{margin:8px 0}summary{cursor:pointer;color:var(--after)}
code{font:13px ui-monospace,Menlo,Consolas,monospace}
footer{margin-top:40px;padding-top:12px;border-top:1px solid var(--rule);color:var(--soft);font-size:12.5px}
footer p{max-width:80em}
.first{display:grid;grid-template-columns:max-content minmax(0,1fr);gap:2px 16px;margin:10px 0;max-width:62em}
.first dt{color:var(--soft)}.first dd{margin:0}
.narrow{display:none}
@media (max-width:900px){main{padding:20px}.cols{grid-template-columns:minmax(0,1fr);gap:12px}}
@media (max-width:600px){main{padding:16px}h1{font-size:20px}h2{margin-top:26px}.first{grid-template-columns:1fr;gap:0}
.first dd{margin-bottom:6px}.broad{display:none}.narrow{display:block}.heat th,.heat td{white-space:nowrap}
.bars,.sides .bars{grid-template-columns:1fr max-content}.bars>span:nth-child(3n+1){grid-column:1/-1;margin-top:3px}
.causes thead{display:none}.causes>tbody>tr>td{display:block;border:0;padding:3px 0}
.causes>tbody>tr{display:block;border-bottom:1px solid var(--rule);padding:6px 0}
.causes>tbody>tr>td:last-child::before{content:"What to do: ";color:var(--soft)}.nums td{white-space:normal}}
@media print{body{background:#fff}main{box-shadow:none;max-width:none;padding:0}
h2{break-after:avoid}figure,tr{break-inside:avoid}}
"""


def page(title: str, body: str) -> str:
    """A whole HTML document."""
    return ('<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
            '<meta name="viewport" content="width=device-width,initial-scale=1">'
            f'<title>{escape(title)}</title><style>{STYLE}</style></head>\n'
            f'<body><main>\n{body}\n</main></body></html>\n')


def figure(drawing: str, caption: str, number: int | None = None) -> str:
    """A drawing with its caption; ``number`` keeps the ids of several apart, where they have any."""
    for before in ('id="', '"#', 'url(#') if number is not None else ():
        drawing = drawing.replace(before, f'{before}f{number}-')
    return f'<figure>{drawing}<figcaption>{caption}</figcaption></figure>'


def table(head: list[str], rows: list[list[str]], kind: str = '') -> str:
    """Cells are HTML already; a head that begins with ``>`` sets its column to the right."""
    right = [h.startswith('>') for h in head]
    cells = ''.join(f'<th{" class=n" if r else ""}>{h.lstrip(">")}</th>'
                    for h, r in zip(head, right, strict=True))
    body = ''.join('<tr>' + ''.join(f'<td{" class=n" if r else ""}>{c}</td>'
                                    for c, r in zip(row, right, strict=True)) + '</tr>\n'
                   for row in rows)
    return f'<table{f" class={kind}" if kind else ""}><thead><tr>{cells}</tr></thead><tbody>{body}</tbody></table>'


def bars(rows: list[tuple[str, float, str]]) -> str:
    """Horizontal bars: label, share 0…1, the text beside it."""
    return '<div class="bars">' + ''.join(
        f'<span>{escape(label)}</span><span class="b"><i style="width:{100 * min(max(share, 0), 1):.1f}%"></i>'
        f'</span><span class="v">{escape(text)}</span>' for label, share, text in rows) + '</div>'
