// The arms in space with their forces, and the gel from above: two small canvases, no outside code.

const style = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
const COLORS = ["--before", "--after"];
//: Length of an arrow by force [m/N].
const ARROW = 0.03;

function prepare(canvas) {
  canvas.dataset.high ||= canvas.getAttribute("height");
  const ratio = window.devicePixelRatio || 1, wide = canvas.clientWidth, high = Number(canvas.dataset.high), g = canvas.getContext("2d");
  canvas.width = wide * ratio; canvas.height = high * ratio; canvas.style.height = `${high}px`;
  g.setTransform(ratio, 0, 0, ratio, 0, 0); g.clearRect(0, 0, wide, high);
  g.font = "12px system-ui, sans-serif"; g.lineCap = g.lineJoin = "round";
  return { g, wide, high };
}

function arrow(g, from, to, color) {
  const dx = to[0] - from[0], dy = to[1] - from[1], long = Math.hypot(dx, dy);
  if (long < 3) return;
  const a = Math.atan2(dy, dx), head = Math.min(9, long / 2);
  g.strokeStyle = g.fillStyle = color; g.lineWidth = 2.5;
  g.beginPath(); g.moveTo(...from); g.lineTo(...to); g.stroke();
  g.beginPath(); g.moveTo(...to);
  for (const s of [-1, 1]) g.lineTo(to[0] - head * Math.cos(a + 0.45 * s), to[1] - head * Math.sin(a + 0.45 * s));
  g.closePath(); g.fill();
}

// where an arm has been, as a box that only grows: the view follows what moves, and does not shake
function grown(view, name, points) {
  const box = ((view.boxes ||= {})[name] ||= { low: [...points[0]], high: [...points[0]] });
  for (const p of points) p.forEach((x, i) => { box.low[i] = Math.min(box.low[i], x); box.high[i] = Math.max(box.high[i], x); });
  return { ...box, middle: box.low.map((x, i) => (x + box.high[i]) / 2), radius: Math.hypot(...box.low.map((x, i) => box.high[i] - x)) / 2 };
}

// a view from the front and above; the user turns it by dragging or with the arrow keys
export function space(canvas, arms, forces, view) {
  const { g, wide, high } = prepare(canvas), names = Object.keys(arms);
  if (!names.length) { g.fillStyle = style("--quiet"); g.fillText("The arms appear when a session runs.", 12, 24); return; }
  const boxes = names.map((name) => grown(view, name, arms[name]));
  const radius = Math.max(0.05, ...boxes.map((box) => box.radius)), room = (high - 24) / 2;
  const scale = Math.min(room, wide / (2 * names.length)) / (1.1 * radius);
  const [c, s, ce, se] = [Math.cos(view.turn), Math.sin(view.turn), Math.cos(view.lift), Math.sin(view.lift)];
  names.forEach((name, k) => {
    const { low, middle } = boxes[k], place = [(wide * (k + 0.5)) / names.length, room];
    const at = (p) => {
      const [x, y, z] = p.map((value, i) => value - middle[i]), u = -s * x + c * y, d = c * x + s * y;
      return [place[0] + scale * u, place[1] - scale * (ce * z - se * d)];
    };
    g.strokeStyle = style("--line"); g.lineWidth = 1;
    for (let i = -2; i <= 2; i++) for (const line of [[[i, -2], [i, 2]], [[-2, i], [2, i]]]) {
      const [a, b] = line.map(([x, y]) => at([middle[0] + 0.4 * x * radius, middle[1] + 0.4 * y * radius, low[2] - 0.05 * radius]));
      g.beginPath(); g.moveTo(...a); g.lineTo(...b); g.stroke();
    }
    g.strokeStyle = style(COLORS[k % 2]); g.lineWidth = 5; g.beginPath();
    arms[name].forEach((p, i) => (i ? g.lineTo(...at(p)) : g.moveTo(...at(p)))); g.stroke();
    g.fillStyle = style("--ink");
    for (const p of arms[name]) { g.beginPath(); g.arc(...at(p), 3.5, 0, 7); g.fill(); }
    const tip = arms[name][arms[name].length - 1], f = forces[name] || [0, 0, 0];
    arrow(g, at(tip), at(tip.map((x, i) => x + ARROW * (f[i] || 0))), style("--bad"));
    g.fillStyle = style("--ink"); g.textAlign = "center"; g.fillText(name, place[0], high - 8); g.textAlign = "left";
  });
}

// where the tip has been over the gel; darker where it pressed harder
export function above(canvas, trail, hidden) {
  const { g, wide, high } = prepare(canvas);
  if (!trail.length) { g.fillStyle = style("--quiet"); g.fillText("The tip appears when a session runs.", 12, 24); return; }
  const last = trail[trail.length - 1];
  let reach = 0.03;
  for (const p of trail) reach = Math.max(reach, Math.abs(p[0] - trail[0][0]), Math.abs(p[1] - trail[0][1]));
  const scale = (0.44 * Math.min(wide, high)) / reach, side = 0.88 * Math.min(wide, high);
  const at = (p) => [wide / 2 - scale * (p[1] - trail[0][1]), high / 2 - scale * (p[0] - trail[0][0])];
  g.fillStyle = style("--band"); g.fillRect((wide - side) / 2, (high - side) / 2, side, side);
  for (const p of trail) {
    g.fillStyle = style("--after"); g.globalAlpha = Math.min(0.9, 0.12 + 0.2 * p[2]);
    g.beginPath(); g.arc(...at(p), 3 + Math.min(6, p[2]), 0, 7); g.fill();
  }
  g.globalAlpha = 1;
  if (!hidden) {
    g.strokeStyle = style("--ink"); g.lineWidth = 2; g.beginPath(); g.arc(...at(last), 9, 0, 7); g.stroke();
    g.beginPath(); for (const [dx, dy] of [[-14, 0], [14, 0]]) { const [x, y] = at(last); g.moveTo(x + dx / 2, y + dy); g.lineTo(x + dx, y + dy); } g.stroke();
  }
  g.fillStyle = style("--quiet"); g.fillText(`side ${(side / scale * 1000).toFixed(0)} mm`, (wide - side) / 2 + 8, (high + side) / 2 - 8);
}
