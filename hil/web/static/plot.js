// Small plots on a canvas: axes with round numbers, lines, points, a brush.  No outside code.

const style = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

export function range(values, pad = 0.04) {
  let low = Infinity, high = -Infinity;
  for (const v of values) if (v !== null && Number.isFinite(v)) { if (v < low) low = v; if (v > high) high = v; }
  if (low > high) return [0, 1];
  if (low === high) { low -= 1; high += 1; }
  const more = (high - low) * pad;
  return [low - more, high + more];
}

function ticks([low, high], most) {
  const raw = (high - low) / most, power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].map((x) => x * power).find((x) => (high - low) / x <= most);
  const out = [];
  for (let k = Math.ceil(low / step); k * step <= high + 1e-12; k++) out.push(k * step);
  return out;
}

const text = (x) => (x === 0 ? "0" : Math.abs(x) >= 1e4 || Math.abs(x) < 1e-3 ? x.toExponential(1) : String(+x.toPrecision(3)));

// draws and returns the frame: x(pixel) and the inverse
export function plot(canvas, { xs, ys, xlabel, ylabel, layers, band = null, brush = null, title = "" }) {
  // the attribute "height" is the wish; it becomes the number of device pixels
  canvas.dataset.high ||= canvas.getAttribute("height");
  const ratio = window.devicePixelRatio || 1, wide = canvas.clientWidth, real = Number(canvas.dataset.high), g = canvas.getContext("2d");
  canvas.width = wide * ratio; canvas.height = real * ratio; canvas.style.height = `${real}px`;
  g.setTransform(ratio, 0, 0, ratio, 0, 0); g.clearRect(0, 0, wide, real);
  g.font = "12px system-ui, sans-serif";
  // the numbers beside the axis have room, and the label before them
  const most = Math.max(...ticks(ys, 5).map((v) => g.measureText(text(v)).width));
  const box = { left: Math.max(62, most + 28), right: wide - 10, top: title ? 26 : 10, bottom: real - 38 };
  const x = (v) => box.left + ((v - xs[0]) / (xs[1] - xs[0])) * (box.right - box.left);
  const y = (v) => box.bottom - ((v - ys[0]) / (ys[1] - ys[0])) * (box.bottom - box.top);
  g.lineWidth = 1;
  if (title) { g.fillStyle = style("--ink"); g.textAlign = "left"; g.fillText(title, box.left, 15); }
  if (band !== null) { g.fillStyle = style("--band"); g.fillRect(box.left, y(band), box.right - box.left, y(-band) - y(band)); }
  if (brush) { g.fillStyle = style("--band"); g.fillRect(x(brush[0]), box.top, x(brush[1]) - x(brush[0]), box.bottom - box.top); }
  g.strokeStyle = style("--line"); g.fillStyle = style("--quiet");
  g.textAlign = "right"; g.textBaseline = "middle";
  for (const v of ticks(ys, 5)) { g.beginPath(); g.moveTo(box.left, y(v)); g.lineTo(box.right, y(v)); g.stroke(); g.fillText(text(v), box.left - 6, y(v)); }
  g.textAlign = "center"; g.textBaseline = "top";
  for (const v of ticks(xs, Math.max(5, wide / 110))) g.fillText(text(v), x(v), box.bottom + 5);
  g.fillText(xlabel, (box.left + box.right) / 2, box.bottom + 20);
  g.save(); g.translate(12, (box.top + box.bottom) / 2); g.rotate(-Math.PI / 2); g.textBaseline = "middle"; g.fillText(ylabel, 0, 0); g.restore();
  g.save(); g.beginPath(); g.rect(box.left, box.top, box.right - box.left, box.bottom - box.top); g.clip();
  for (const layer of layers) {
    g.strokeStyle = g.fillStyle = style(layer.color);
    if (layer.kind === "points") {
      g.globalAlpha = 0.45;
      for (let k = 0; k < layer.x.length; k++) g.fillRect(x(layer.x[k]) - 1, y(layer.y[k]) - 1, 2, 2);
      g.globalAlpha = 1;
    } else {
      g.lineWidth = layer.width || 1.3; g.beginPath();
      let open = false;
      for (let k = 0; k < layer.x.length; k++) {
        if (layer.y[k] === null) { open = false; continue; }  // nothing is known there
        const gap = layer.group && k && layer.group[k] !== layer.group[k - 1];
        if (open && !gap) g.lineTo(x(layer.x[k]), y(layer.y[k])); else g.moveTo(x(layer.x[k]), y(layer.y[k]));
        open = true;
      }
      g.stroke();
    }
  }
  g.restore();
  return { inverse: (px) => xs[0] + ((px - box.left) / (box.right - box.left)) * (xs[1] - xs[0]) };
}
