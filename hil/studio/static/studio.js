// The page of the studio: what the bench shows, and what the user asks of it.
import { plot, range } from "./plot.js";
import { $, answered, ask, call, early, el } from "./page.js";
import { files, start } from "./intake.js";

let state = null, brush = null, frame = null, asked = 0, tab = 0;

function show() {
  $("main").hidden = false;
  for (const id of ["places", "candidates"]) $(id).removeAttribute("aria-busy");
  $("sessions").textContent = `${state.sessions.join(", ")}${state.holdout.length ? `, judged on ${state.holdout.join(", ")}` : ", judged on blocks that were not fitted"}`;
  $("adequate").textContent = state.adequate;
  ladder(); verdict(); joints(); besides(); exports(); draw(); places(); candidates(); learnt(); model(); notes();
  const last = state.ladder.length - 1;
  $("undo").disabled = state.at === 0; $("redo").disabled = state.at === last;
}

function ladder(rungs = state.ladder, at = state.at, waits = false) {
  const out = $("ladder");
  out.replaceChildren(); out.style.setProperty("--joints", state.joints.length);
  const head = el("div", "", "rung head");
  head.append(el("span", "model"), ...state.joints.map((j) => el("span", j)));
  out.append(head);
  const most = Math.max(2, ...rungs.flatMap((r) => (r.joints || []).map((x) => x.ratio || 0)));
  rungs.forEach((r, k) => {
    const row = el("div", "", `rung${k === at ? " now" : ""}${k > at ? " gone" : ""}`);
    const name = el("button", r.label, "name"); name.type = "button"; name.disabled = waits;
    name.setAttribute("aria-label", `Show model ${k}: ${r.label}`);
    if (k === at) name.setAttribute("aria-current", "true");
    name.onclick = () => ask("go", { at: String(k) });
    row.append(name);
    state.joints.forEach((j, i) => {
      const x = r.joints ? r.joints[i] : null, bar = el("div", "", `bar${x && x.ratio <= state.adequate ? " met" : ""}`);
      if (x) {
        const fill = el("i"); fill.style.width = `${(100 * x.ratio) / most}%`;
        bar.append(fill, el("b", `${x.ratio.toFixed(2)} (${x.relative.toFixed(1)} %)`));
        bar.setAttribute("role", "img"); bar.setAttribute("aria-label", `${r.label}, ${j}: ${x.ratio.toFixed(2)} times the floor, ${x.relative.toFixed(1)} %`);
      } else bar.append(el("b", "not compared yet"));
      bar.dataset.joint = j; // shown in a narrow window, which has no head
      row.append(bar);
    });
    out.append(row);
  });
}

function verdict() {
  const d = state.diagnosis;
  $("verdict").hidden = !d;
  if (!d) return;
  $("headline").textContent = (state.ladder[state.at].label === d.of ? "" : `Of ${d.of}: `) + d.text;
  // it is the model that is shown
  $("take").hidden = state.ladder[state.at].label.startsWith("diagnosis:");
  const percent = (x) => (x === null ? "-" : `${x.toPrecision(3)} %`);
  $("findings").replaceChildren(...d.findings.map((f) => el("li",
    `${f.effect}${f.joint ? ` on ${f.joint}` : ""}: confidence ${f.confidence > 0.99 ? "above 0.99" : f.confidence.toFixed(2)}, held-out error ${percent(f.relative_before)} → ${percent(f.relative_after)}`
    + (f.rivals.length ? `; these explain as much: ${f.rivals.join(", ")}` : ""))));
  const sets = $("sets");
  sets.replaceChildren();
  const all = [...d.indistinguishable.map((s) => [s.effects.join(", "), s.why, s.command || s.experiment]),
    ...d.could_not_show.map((u) => [u.effects.join(", "), u.why, u.command])];
  if (all.length) {
    const box = el("details");
    box.append(el("summary", `What these data cannot tell (${all.length})`));
    const list = el("ul");
    for (const [names, why, how] of all) list.append(el("li", `${names}: ${why}${how ? `. What would: ${how}` : ""}`));
    box.append(list); sets.append(box);
  }
}

function joints() {
  const box = $("joint"), old = box.selectedIndex;
  box.replaceChildren(...state.joints.map((j, i) => { const o = el("option", j); o.value = i; return o; }));
  if (old >= 0) { box.selectedIndex = old; return; }
  // the joint that fails most
  const now = state.ladder[state.at].joints;
  box.selectedIndex = now.reduce((best, x, i) => (x.ratio > now[best].ratio ? i : best), 0);
}

function besides() {
  const box = $("beside"), none = el("option", "no other model");
  none.value = "";
  const others = state.ladder.map((r, k) => [r.label, k]).filter(([, k]) => k !== state.at);
  box.replaceChildren(none, ...others.map(([label, k]) => { const o = el("option", label); o.value = k; o.selected = state.beside && state.beside.at === k; return o; }));
  box.disabled = !others.length;
}

function exports() {
  const box = $("kind");
  if (box.options.length) return;
  box.append(...state.exports.map((x) => { const o = el("option", x.name); o.value = x.name; o.title = x.what; return o; }));
  box.onchange = () => {
    const x = state.exports[box.selectedIndex];
    $("export-path").value = `robot-${x.name}${x.ending}`; $("export-what").textContent = x.what;
  };
  box.onchange();
}

const inside = (t) => !brush || (t >= brush[0] && t <= brush[1]);

// how large the error of the joint is in the part that was dragged over
function brushed(residual, floor, unit) {
  if (!brush) return "Drag over a part to see it alone in the views below.";
  const rms = Math.sqrt(residual.reduce((sum, x) => sum + x * x, 0) / residual.length);
  const error = residual.length ? `: error ${rms.toPrecision(2)} ${unit}, ${(rms / floor).toFixed(2)} times the floor` : ": no sample";
  return `${brush[0].toFixed(2)} to ${brush[1].toFixed(2)} s${error}`;
}

function draw() {
  const i = $("joint").selectedIndex, s = state.series, j = s.joints[i], unit = state.units[i];
  const y = `residual [${unit}]`;
  const beside = state.beside && state.beside.joints[i];
  const layers = [{ x: j.trace.t, y: j.trace.y, color: beside ? "--after" : "--before", group: j.trace.run }];
  if (beside) layers.unshift({ x: beside.t, y: beside.y, color: "--before", group: beside.run });
  frame = plot($("residual"), { xs: range(s.t, 0), ys: range([...j.trace.y, ...(beside ? beside.y : []), j.floor, -j.floor]), xlabel: "time [s]", ylabel: y, band: j.floor, brush, layers });
  $("key").hidden = !beside;
  if (beside) { $("key-now").textContent = state.ladder[state.at].label; $("key-beside").textContent = state.beside.label; }
  $("residual").setAttribute("aria-label", `Residual of ${state.joints[i]} over time; the band is the noise floor`);
  const keep = s.t.map(inside);
  const part = (v) => v.filter((_, k) => keep[k]), residual = part(j.residual);
  const views = [["over-speed", j.speed, `speed [${state.motion[i]}/s]`, "speed"], ["over-position", j.position, `position [${state.motion[i]}]`, "position"], ["over-effort", j.effort, `effort [${unit}]`, "effort"]];
  for (const [id, values, label, name] of views) {
    const x = part(values);
    plot($(id), { xs: range(values), ys: range([...j.residual, j.floor, -j.floor]), xlabel: label, ylabel: y, band: j.floor, title: `over ${name}`,
      layers: [{ kind: "points", x, y: residual, color: "--before" }] });
    $(id).setAttribute("aria-label", `Residual of ${state.joints[i]} over ${name}`);
  }
  $("whole").hidden = !brush; $("places-of").hidden = !brush;
  $("brushed").textContent = brushed(residual, j.floor, unit);
}

function places() {
  const found = state.where[state.joints[$("joint").selectedIndex]] || [];
  $("places").replaceChildren(...(found.length ? found.map((r) => el("li", r.text)) : [el("li", "Nothing stands out beyond its noise band.")]));
}

function candidates() {
  const body = $("candidates").tBodies[0];
  body.replaceChildren(...state.candidates.map((c) => {
    const row = el("tr"), add = el("button", "Add");
    add.type = "button"; add.setAttribute("aria-label", `Add ${c.effect} on ${c.joint || "the robot"}`);
    add.onclick = () => ask("add", { effect: c.effect, joint: c.joint || "" });
    const last = el("td"); last.append(add);
    const name = el("td", c.effect);
    if (c.own) name.append(" ", el("span", "yours", "tag"));
    row.append(name, el("td", c.joint || "robot"), el("td", c.relative_after === null ? "-" : `${c.relative_after.toPrecision(3)} %`, "n"),
      el("td", c.confidence ? c.confidence.toFixed(2) : "-", "n"), el("td", c.meaning), last);
    return row;
  }));
}

function learnt() {
  $("learnt-part").hidden = !state.learnt.length;
  $("learnt").replaceChildren(...state.learnt.map((f) => {
    const figure = el("figure"), canvas = el("canvas");
    canvas.setAttribute("height", 220); canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", `${f.effect} on ${f.joint}: data and law`);
    figure.append(canvas); return figure;
  }));
  laws();
}

// every law over its data: their means, or the points of the part that was dragged over
function laws() {
  [...$("learnt").querySelectorAll("canvas")].forEach((canvas, k) => {
    const f = state.learnt[k], p = f.points, unit = state.units[state.joints.indexOf(f.joint)];
    const part = (v) => v.filter((_, i) => inside(p.t[i]));
    const data = brush ? { kind: "points", x: part(p.x), y: part(p.y), color: "--data" } : { x: f.x, y: f.data, color: "--data", width: 2.4 };
    plot(canvas, { xs: range(f.x), ys: range([...f.data, ...f.law, ...(brush ? data.y : [])]), xlabel: f.label, ylabel: `effort [${unit}]`,
      title: `${f.effect} on ${f.joint}: data (grey), law (blue)`, layers: [data, { x: f.x, y: f.law, color: "--after", width: 1.8 }] });
  });
}

function model() {
  const body = $("model").tBodies[0], plain = new Set();
  body.replaceChildren();
  for (const use of state.model) {
    use.values.forEach((v, k) => {
      const row = el("tr"), last = el("td", v.note);
      if (k === 0 && state.model.length > 1) {
        const b = el("button", "Remove"); b.type = "button"; b.setAttribute("aria-label", `Remove ${use.effect} from ${use.joint || "the robot"}`);
        b.onclick = () => ask("remove", { effect: use.effect, joint: use.joint }); last.append(" ", b);
      }
      row.append(el("td", k === 0 ? use.effect : ""), el("td", k === 0 ? use.joint || "robot" : ""), el("td", v.name), el("td", v.value === null ? "-" : String(v.value), "n"),
        el("td", v.half === null ? "-" : String(v.half), "n"), el("td", v.unit), last);
      body.append(row);
    });
  }
}

function notes() {
  $("warnings").replaceChildren(...(state.warnings.length ? state.warnings.map((w) => el("li", w)) : [el("li", "Nothing is wrong with the recording.")]));
  $("commands").textContent = state.commands.join("\n");
}

// ------------------------------------------------------------ what the user does
$("undo").onclick = () => ask("undo");
$("redo").onclick = () => ask("redo");
$("diagnose").onclick = () => ask("diagnose");
$("take").onclick = () => ask("take");
$("cancel").onclick = () => call("/api/cancel", {}).catch(() => {}); // the wait for the answer says where there is none
$("beside").onchange = () => ask("beside", { at: $("beside").value });
$("export").onsubmit = (e) => { e.preventDefault(); ask("export", { kind: $("kind").value, path: $("export-path").value }); };
$("own").onsubmit = (e) => {
  e.preventDefault();
  ask("learn", { path: $("own-path").value, text: $("own-text").value, agreed: $("agreed").checked ? "yes" : "" });
  $("agreed").checked = false; // every text is agreed to anew
};
$("own-text").oninput = () => { $("agreed").checked = false; };
$("own-part").ontoggle = async () => {
  if (!$("own-part").open || $("own-path").value) return;
  const found = await call("/api/template");
  // what was written while it came stays
  $("own-text").value ||= found.text; $("own-path").value ||= found.path;
};
$("joint").onchange = () => { draw(); places(); };
$("whole").onclick = () => { brush = null; draw(); laws(); };
$("save").onsubmit = (e) => { e.preventDefault(); ask("save", { path: $("path").value }); };
$("report").onsubmit = (e) => { e.preventDefault(); ask("report", { path: $("page").value }); };
const canvas = $("residual");
canvas.onpointerdown = (e) => { asked = frame.inverse(e.offsetX); canvas.setPointerCapture(e.pointerId); tab = 1; };
canvas.onpointermove = (e) => {
  if (!tab) return;
  const end = frame.inverse(e.offsetX);
  brush = [Math.min(asked, end), Math.max(asked, end)];
  draw(); laws();
};
canvas.onpointerup = () => { tab = 0; if (brush && brush[1] - brush[0] < 0.02) brush = null; draw(); laws(); };
canvas.onkeydown = (e) => {
  const t = state.series.t, whole = t[t.length - 1] - t[0], step = whole / 20;
  if (e.key === "Escape") brush = null;
  else if (e.key === "ArrowRight" || e.key === "ArrowLeft") {
    const d = e.key === "ArrowRight" ? step : -step;
    brush = brush ? [brush[0] + d, brush[1] + d] : [t[0], t[0] + 4 * step];
  } else return;
  e.preventDefault(); draw(); laws();
};
window.addEventListener("resize", () => state && (draw(), learnt()));
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => state && (draw(), learnt()));
// what this model changed, in words: who adds an effect does not see the ladder
const CHANGED = 0.02;
function fall() {
  const [before, now] = [state.ladder[state.at - 1], state.ladder[state.at]];
  if (!before || !before.joints || !now.joints) return "";
  const told = state.joints.map((j, i) => [j, before.joints[i], now.joints[i]])
    .filter(([, a, b]) => a && b && Math.abs(b.relative - a.relative) > CHANGED * a.relative)
    .map(([j, a, b]) => `${j}: ${a.relative.toFixed(1)} % to ${b.relative.toFixed(1)} %`);
  return `${told.length ? `Error of ${told.join(", ")}` : "The error stays"} (${now.label}).`;
}
let first = null;
early((rungs, more) => {
  if (!state) return;
  ladder(rungs, rungs.length - 1, true);
  if (!more || more === first || !more.series) return;
  // the new model's curves and parameters; where it fails and what may be missing is not known yet
  first = more; state = { ...state, series: more.series, learnt: more.learnt, model: more.model, beside: null };
  for (const id of ["places", "candidates"]) $(id).setAttribute("aria-busy", "true");
  draw(); learnt(); model();
});
start();
answered((now, found) => {
  files(now, found);
  if (now) { state = now; show(); return fall(); }
  for (const id of ["undo", "redo", "diagnose"]) $(id).disabled = true;
  return "";
});
