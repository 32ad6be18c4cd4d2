'use strict';
// Draws what the websocket tells.  Texts are set as text, never as HTML: a name from outside stays a name.

const SVG = 'http://www.w3.org/2000/svg';
const NARROW = '\u202f';
const KEPT_S = 60;
const OPEN = 1e-4;    // m or rad: an error whose standard uncertainty exceeds it is open, as in every answer
const byId = id => document.getElementById(id);
const chosen = () => decodeURIComponent(location.hash.slice(1));
let scene = null, now = null, shown = null, lengths = [], spots = [], socket = null, attempt = 0;

function made(tag, attributes = {}, ...children) {
  const node = document.createElement(tag);
  for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
  node.append(...children);
  return node;
}

function drawn(tag, attributes) {
  const node = document.createElementNS(SVG, tag);
  for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
  return node;
}

// A number with so many digits as a difference of `step` needs, and a true minus.
function digits(value, step) {
  const places = Math.min(9, Math.max(0, -Math.floor(Math.log10(step || 1))));
  return (Math.abs(value) < step / 2 ? 0 : value).toFixed(places).replace('-', '\u2212');
}

// A value with its expanded uncertainty (k = 2) in a unit that people read: two digits of the uncertainty.
function quantity(value, U, unit) {
  if (value === null || !isFinite(value) || U > 2 * OPEN) return 'open';
  const name = unit === 'm' ? 'µm' : 'µrad', v = value * 1e6, u = U === null ? NaN : U * 1e6;
  if (!isFinite(u) || u <= 0) return `${digits(v, Math.abs(v) / 100)}${NARROW}${name}, U unknown`;
  return `${digits(v, u / 10)} ± ${digits(u, u / 10)}${NARROW}${name}`;
}

// --- the connection -----------------------------------------------------------------------------

function connect() {
  if (socket) { socket.onclose = null; socket.close(); }
  scene = now = shown = null; lengths = []; spots = [];
  byId('detail').hidden = true;
  for (const id of ['curves', 'squareness', 'remarks', 'gap', 'streams', 'scene']) byId(id).replaceChildren();
  byId('state').textContent = byId('where').textContent = '';
  byId('fit').textContent = 'None yet: they come with the first setup that can be evaluated.';
  socket = new WebSocket(`${location.protocol === 'https:' ? 'wss' : 'ws'}://${location.host}/live?machine=`
    + encodeURIComponent(chosen()));
  socket.onmessage = event => { attempt = 0; show(JSON.parse(event.data)); };
  socket.onclose = () => {
    badge(byId('link'), 'bad', 'no connection: what is shown is old');
    setTimeout(connect, Math.min(10000, 500 * 2 ** attempt++));
  };
}

function badge(node, kind, text) { node.className = `badge ${kind}`; node.textContent = text; }

function show(told) {
  badge(byId('link'), 'good', 'live');
  if (!chosen() && told.hall.machines.length) {    // the first one that is at work, else the first
    const first = told.hall.machines.find(machine => machine.under_way) || told.hall.machines[0];
    history.replaceState(null, '', `#${encodeURIComponent(first.name)}`);
    connect();
    return;
  }
  byId('trouble').hidden = !told.trouble;
  byId('trouble').textContent = told.trouble || '';
  showHall(told.hall);
  showReports(told.reports);
  if (told.machine) showMachine(told.machine);
}

// --- the hall -----------------------------------------------------------------------------------

function showHall(hall) {
  byId('lights').replaceChildren(...hall.lights.map(light => {
    const queue = made('div', {class: 'queue'});
    if (light.holder) queue.append(made('span', {class: 'has'}, `${light.holder} has the light, ${light.held_s.toFixed(0)} of about ${light.expected_s.toFixed(0)} s`));
    else queue.append(made('span', {}, 'nobody has the light'));
    light.queue.forEach(([name, wait], place) => queue.append(made('span', {}, `${place + 1}. ${name} in about ${wait} s`)));
    if (!light.queue.length) queue.append(made('span', {}, 'nobody waits'));
    const use = light.grants ? made('p', {class: 'soft'}, `used for ${light.used_s.toFixed(0)} s in ${light.grants} grants, idle though wanted ${(100 * light.idle_share).toFixed(1)} %`) : '';
    return made('div', {class: 'light'}, made('b', {}, `Laser ${light.name}`), queue, use);
  }));
  byId('none').hidden = hall.machines.length > 0;
  byId('machines').replaceChildren(...hall.machines.map(machine => {
    const card = made('a', {class: machine.name === chosen() ? 'card chosen' : 'card', href: `#${encodeURIComponent(machine.name)}`});
    card.append(made('b', {}, machine.name, made('small', {}, machine.under_way ? `${machine.stop}/${machine.stops} stops, about ${machine.left_s.toFixed(0)} s left` : '')));
    const bar = made('div', {class: 'bar'}), full = made('i');
    full.style.width = machine.under_way ? `${100 * machine.stop / machine.stops}%` : '0';
    bar.append(full);
    card.append(bar, made('p', {}, machine.doing));
    return card;
  }));
  byId('unwell').hidden = !hall.troubles.length;
  byId('troubles').replaceChildren(...hall.troubles.map(one => made('li', {}, `${one.node}: ${one.text}`)));
}

function showReports(reports) {
  byId('noreports').hidden = reports.length > 0;
  const list = byId('reports');
  if (list.childElementCount === reports.length) return;    // a link under the pointer stays where it is
  list.replaceChildren(...reports.map(one => made('li', {}, made('a', {href: one.address, target: '_blank', rel: 'noopener'}, one.name), ` of ${one.machine}`)));
}

// --- one machine --------------------------------------------------------------------------------

function showMachine(told) {
  byId('detail').hidden = false;
  byId('name').textContent = told.name + (told.trouble ? `: ${told.trouble}` : '');
  if (told.scene) { scene = told.scene; shown = null; }
  if (told.now) {
    now = told.now;
    byId('where').textContent = `${now.doing} stop ${now.stop} of run ${now.run} (${now.position.map(c => digits(1e3 * c, 0.1)).join(', ')}) mm commanded`
      + (told.recording ? `; recorded as ${told.recording}` : '');
  } else if (scene) byId('where').textContent = `setup ${scene.setup}; not measured yet`;
  lengths.push(...told.lengths); spots.push(...told.spots);
  trim(lengths); trim(spots);
  drawStreams();
  if (told.errors) showErrors(told.errors);
  if (told.gap) showGap(told.gap);
  if (scene) requestAnimationFrame(drawScene);
}

function trim(rows) {
  const last = rows.length ? rows[rows.length - 1][1] : 0;
  while (rows.length && rows[0][1] < last - KEPT_S) rows.shift();
}

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const plus = (a, b, scale = 1) => [a[0] + scale * b[0], a[1] + scale * b[1], a[2] + scale * b[2]];

// The projection of `stepdiag scene`: parallel, a little from above, the setup's direction from left to right.
function camera(d) {
  const heading = Math.hypot(d[0], d[1]) > 1e-6 ? Math.atan2(d[1], d[0]) : -8 * Math.PI / 180;
  const side = heading - 62 * Math.PI / 180, rise = 21 * Math.PI / 180;
  const eye = [Math.cos(side) * Math.cos(rise), Math.sin(side) * Math.cos(rise), Math.sin(rise)];
  const right = [-Math.sin(side), Math.cos(side), 0];
  const up = [eye[1] * right[2] - eye[2] * right[1], eye[2] * right[0] - eye[0] * right[2], eye[0] * right[1] - eye[1] * right[0]];
  return point => [dot(point, right), -dot(point, up)];
}

function drawScene() {
  if (!scene) return;    // another machine was chosen since this picture was asked for
  const [u, v, d] = scene.triad, target = now && now.setup === scene.setup ? now.point : scene.path[0];
  if (!shown) shown = target.slice();
  const off = plus(target, shown, -1);
  const rest = Math.hypot(...off);
  shown = rest < 1e-5 ? target.slice() : plus(shown, off, 0.3);    // glides to where the machine was sent
  const flat = camera(d), boxed = [];
  for (let i = 0; i < 8; i++) boxed.push([0, 1, 2].map(axis => scene.corner[axis] + (i >> axis & 1) * scene.volume[axis]));
  const [cu, cv] = scene.mirror_centre, [hu, hv] = scene.mirror_half;
  const mirror = at => [[-1, -1], [1, -1], [1, 1], [-1, 1]].map(([a, b]) => plus(plus(at, u, cu + a * hu), v, cv + b * hv));
  const size = 0.05 * Math.hypot(...scene.volume), back = plus(scene.origin, d, -3 * size);
  const unit = [back, scene.origin].map(at => [[-1, -1], [1, -1], [1, 1], [-1, 1]].map(([a, b]) => plus(plus(at, u, a * size), v, b * size)));
  const all = [...boxed, ...unit.flat(), ...scene.path.flatMap(mirror)].map(flat);
  const low = [0, 1].map(i => Math.min(...all.map(p => p[i]))), high = [0, 1].map(i => Math.max(...all.map(p => p[i])));
  const width = 580, height = 400, svg = byId('scene'), letters = Math.max(11, 11 * width / (svg.clientWidth || width));
  const side = 4 * letters, scale = Math.min((width - side) / (high[0] - low[0]), (height - 4 * letters) / (high[1] - low[1]));
  const at = point => { const p = flat(point); return [(width - scale * (low[0] + high[0])) / 2 + scale * p[0], (height - scale * (low[1] + high[1])) / 2 + scale * p[1]]; };
  const line = points => points.map(p => at(p).map(c => c.toFixed(1)).join(',')).join(' ');
  const parts = [];
  for (let a = 0; a < 8; a++) for (let axis = 0; axis < 3; axis++) if (!(a >> axis & 1))
    parts.push(drawn('polyline', {points: line([boxed[a], boxed[a | 1 << axis]]), fill: 'none', stroke: '#b9c3cc', 'stroke-width': 1}));
  for (let axis = 0; axis < 3; axis++) {
    const end = at(boxed[1 << axis]), label = drawn('text', {x: end[0] + 5, y: end[1] + letters + 1});
    if (end[0] + 5 * letters > width) label.setAttribute('text-anchor', 'end');
    label.style.fontSize = `${letters.toFixed(1)}px`;
    label.textContent = `${'XYZ'[axis]} ${(1e3 * scene.volume[axis]).toFixed(0)} mm`;
    parts.push(label);
  }
  parts.push(drawn('polyline', {points: line(scene.path), fill: 'none', stroke: '#17688a', 'stroke-width': 1.6}));
  for (const face of unit) parts.push(drawn('polygon', {points: line(face), fill: '#8a97a3', stroke: '#22303c', 'stroke-width': 0.7}));
  for (let i = 0; i < 4; i++) parts.push(drawn('polygon', {points: line([unit[0][i], unit[0][(i + 1) % 4], unit[1][(i + 1) % 4], unit[1][i]]), fill: '#a7b2bc', stroke: '#22303c', 'stroke-width': 0.7}));
  const strike = start => plus(start, d, dot(plus(shown, start, -1), d));
  parts.push(drawn('polyline', {points: line([scene.psd_start, strike(scene.psd_start)]), fill: 'none', stroke: '#c97a05', 'stroke-width': 1.5}));
  for (const start of scene.starts) parts.push(drawn('polyline', {points: line([start, strike(start)]), fill: 'none', stroke: '#d1304b', 'stroke-width': 2, class: 'ray'}));
  parts.push(drawn('polygon', {points: line(mirror(shown)), fill: '#2f7fb5', 'fill-opacity': 0.4, stroke: '#2f7fb5', 'stroke-width': 1.4, class: 'mirror'}));
  svg.setAttribute('viewBox', `0 0 ${width} ${height}`);
  svg.replaceChildren(...parts);
  if (rest >= 1e-5) requestAnimationFrame(drawScene);
}

// --- the instruments ----------------------------------------------------------------------------

function drawStreams() {
  const last = lengths[lengths.length - 1], spot = spots[spots.length - 1];
  const words = row => row && row[2] !== null ? `${digits(1e3 * row[2], 1e-5)} mm, ${row[3] < 1e-6 ? `scatter of a sample ${digits(1e9 * row[3], 0.1)} nm` : 'moving'}` : 'no signal';
  const place = (row, column) => row && row[column] !== null ? `${digits(1e6 * row[column], 0.01)} µm` : 'no light';
  byId('streams').replaceChildren(
    stream('displacement, as read', words(last), lengths, 2, 1e3, 'mm', 'var(--beam)'),
    stream('spot x, as read', place(spot, 2), spots, 2, 1e6, 'µm', 'var(--spot)'),
    stream('spot y, as read', place(spot, 3), spots, 3, 1e6, 'µm', 'var(--spot)'));
}

function stream(title, value, rows, column, factor, unit, colour) {
  const width = 560, height = 118, svg = drawn('svg', {viewBox: `0 0 ${width} ${height}`, preserveAspectRatio: 'none'});
  const there = rows.filter(row => row[column] !== null);
  if (there.length > 1) {
    const end = rows[rows.length - 1][1], span = Math.min(KEPT_S, Math.max(10, end - rows[0][1])), values = there.map(row => factor * row[column]);
    let low = Math.min(...values), high = Math.max(...values);
    const least = unit === 'mm' ? 1e-5 : 0.1;
    if (high - low < least) { const middle = (low + high) / 2; low = middle - least / 2; high = middle + least / 2; }
    const pieces = [];
    let open = false;
    for (const row of rows) {    // a reading without signal is a hole, not a line across it
      if (row[column] === null) { open = false; continue; }
      const x = width * (1 + (row[1] - end) / span), y = height - 8 - (height - 16) * (factor * row[column] - low) / (high - low);
      pieces.push(`${open ? 'L' : 'M'}${x.toFixed(1)} ${y.toFixed(1)}`);
      open = true;
    }
    svg.append(drawn('path', {d: pieces.join(''), fill: 'none', stroke: colour, 'stroke-width': 1.3, 'vector-effect': 'non-scaling-stroke'}));
    const step = (high - low) / 100;
    value += `; ${digits(low, step)} to ${digits(high, step)} ${unit} in the last ${span.toFixed(0)} s`;
  }
  return made('figure', {class: 'stream'}, made('figcaption', {}, made('b', {}, title), made('span', {}, value)), svg);
}

// --- the errors ---------------------------------------------------------------------------------

function showErrors(errors) {
  badge(byId('state'), errors.complete ? (errors.status === 'ok' ? 'good' : 'bad') : 'warn', errors.complete ? `complete: ${errors.status}` : 'so far');
  const largest = {m: 0, rad: 0};
  for (const curve of errors.curves) known(curve).forEach(([, value, U]) => {
    largest[curve.unit] = Math.max(largest[curve.unit], Math.abs(value) + Math.min(U, Math.abs(value) + 1e-6));
  });
  const drawnTo = (what, unit) => largest[unit] ? `${what} are drawn to ±${digits(1e6 * largest[unit], 0.1)}${NARROW}µ${unit}. ` : '';
  const chi2 = errors.reduced_chi2 === null || !errors.dof ? 'no degrees of freedom yet' : `reduced χ² ${errors.reduced_chi2.toFixed(2)} over ${errors.dof} degrees of freedom`;
  byId('fit').textContent = `${chi2}. Line: value at the plan's positions; band: ± U (k = 2); written: from lowest to highest ± the largest U (k = 2). `
    + drawnTo('Translations', 'm') + drawnTo('Rotations', 'rad') + 'Open: the log does not tell yet. '
    + (errors.reference_temperature === null ? 'Lengths are at the temperature of the measurement' : `Lengths are referred to ${errors.reference_temperature} °C`)
    + (errors.traceable ? '.' : '; the index of air was not taken into account.');
  byId('curves').replaceChildren(...errors.curves.map(curve => small(curve, largest[curve.unit] || 1e-6)));
  byId('squareness').replaceChildren(made('tr', {}, made('th', {}, 'squareness'), made('th', {}, 'angle ± U (k = 2)')),
    ...['EC0Y', 'EB0Z', 'EA0Z'].map((name, i) => made('tr', {}, made('td', {}, name), made('td', {}, quantity(errors.squareness[i], 2 * (errors.squareness_sigma[i] ?? NaN), 'rad')))));
  const said = [...errors.unidentifiable.map(text => `open: ${text}`), ...errors.warnings];
  byId('remarks').replaceChildren(...(said.length ? [made('details', {}, made('summary', {}, `${said.length} remarks: what the log leaves open, and warnings`), made('ul', {}, ...said.map(text => made('li', {}, text))))] : []));
}

// Positions, values and U (k = 2) of what the log says something about.
function known(curve) {
  return curve.position.map((position, i) => [position, curve.value[i], 2 * (curve.sigma[i] ?? Infinity)])
    .filter(([, value, U]) => value !== null && U <= 2 * OPEN);
}

function small(curve, size) {
  const width = 160, height = 100, svg = drawn('svg', {viewBox: `0 0 ${width} ${height}`, preserveAspectRatio: 'none'});
  const length = curve.position[curve.position.length - 1] || 1;
  const x = position => 4 + (width - 8) * position / length;
  const y = value => height / 2 - (height / 2 - 4) * Math.max(-1.3, Math.min(1.3, value / size));
  const there = known(curve);
  const line = rows => rows.map(([position, value]) => `${x(position).toFixed(1)},${y(value).toFixed(1)}`).join(' ');
  svg.append(drawn('line', {x1: 0, x2: width, y1: height / 2, y2: height / 2, stroke: '#d5dbe0', 'stroke-width': 1}));
  svg.append(drawn('polygon', {points: line([...there.map(([p, v, U]) => [p, v + U]), ...there.map(([p, v, U]) => [p, v - U]).reverse()]), fill: '#cfe2ea'}));
  svg.append(drawn('polyline', {points: line(there), fill: 'none', stroke: '#17688a', 'stroke-width': 1.7, 'vector-effect': 'non-scaling-stroke'}));
  const values = there.map(row => row[1]);
  const range = values.length > 1 ? quantity(Math.max(...values) - Math.min(...values), Math.max(...there.map(row => row[2])), curve.unit) : 'open';
  const rest = values.length > 1 && there.length < curve.position.length ? '; the rest is open' : '';
  return made('figure', {class: 'curve'}, svg, made('figcaption', {}, made('b', {}, curve.name), range + rest));
}

function showGap(gap) {
  const words = {no_gap: 'log and simulator agree', explained: 'a gap, explained', partly_explained: 'a gap, partly explained', unexplained: 'a gap, unexplained'};
  const nm = value => value === null ? 'open' : `${(1e9 * value).toPrecision(3)} nm`;
  byId('gap').replaceChildren(made('h2', {}, 'Gap to the simulator'),
    made('p', {}, `${words[gap.verdict] || gap.verdict}: ${gap.channel} ${nm(gap.before)} before, ${nm(gap.after)} after, noise alone ${nm(gap.noise_floor)} (root mean squares of readings that were not fitted)`),
    made('ul', {}, ...gap.effects.map(one => made('li', {}, `${one.name}: probability ${one.probability.toFixed(2)}, closes ${(100 * one.closes).toFixed(0)} % of the gap`))),
    gap.next_measurement ? made('p', {class: 'todo'}, gap.next_measurement) : '');
}

addEventListener('hashchange', connect);
connect();
