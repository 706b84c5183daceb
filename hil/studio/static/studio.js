// The page of the studio: asks, waits, draws.  Every word of the data is set as text, never as markup.
import { plot, range } from "./plot.js";

const token = new URLSearchParams(location.search).get("token") || "";
const $ = (id) => document.getElementById(id);
let state = null, brush = null, frame = null, asked = 0, tab = 0;

function el(name, content = "", kind = "") {
  const e = document.createElement(name);
  if (content !== "") e.textContent = content;
  if (kind) e.className = kind;
  return e;
}

async function call(path, body) {
  const options = { headers: { "X-Hil-Token": token } };
  if (body !== undefined) { options.method = "POST"; options.body = JSON.stringify(body); }
  const answer = await fetch(path, options);
  return answer.json();
}

function say(text, error = false) { $("said").textContent = text; $("status").classList.toggle("error", error); }

async function ask(verb, more = {}) {
  const found = await call("/api/ask", { verb, ...more });
  if (found.error) { say(found.error, true); return; }
  watch();
}

const DOING = { start: "Fitting the model", add: "Adding the effect and fitting again", remove: "Fitting without the effect",
  diagnose: "Diagnosing", take: "Fitting the recommended model", undo: "Going back", redo: "Going forward", save: "Saving", report: "Writing the report" };
let watching = false;

async function watch() {
  if (watching) return;
  watching = true;
  for (const b of document.querySelectorAll("button:not(#cancel):not(#whole)")) b.disabled = true;
  let now;
  for (;;) {
    try { now = await call("/api/status"); } catch { say("The studio does not answer; is it still running?", true); await wait(1000); continue; }
    if (!now.running) break;
    $("cancel").hidden = false;
    say(`${DOING[now.running] || now.running}… ${now.seconds.toFixed(0)} s`);
    await wait(150);
  }
  watching = false;
  $("cancel").hidden = true;
  const next = await call("/api/state");
  if (next) { state = next; show(); }
  say(now.error || now.note || "Ready.", Boolean(now.error));
}

const wait = (ms) => new Promise((done) => setTimeout(done, ms));

function show() {
  $("main").hidden = false;
  $("sessions").textContent = `${state.sessions.join(", ")}${state.holdout.length ? `, judged on ${state.holdout.join(", ")}` : ", judged on blocks that were not fitted"}`;
  $("adequate").textContent = state.adequate;
  ladder(); verdict(); joints(); draw(); places(); candidates(); learnt(); model(); notes();
  const last = state.ladder.length - 1;
  for (const b of document.querySelectorAll("button")) b.disabled = false;
  $("undo").disabled = state.at === 0; $("redo").disabled = state.at === last;
}

function ladder() {
  const out = $("ladder");
  out.replaceChildren(); out.style.setProperty("--joints", state.joints.length);
  const head = el("div", "", "rung head");
  head.append(el("span", "model"), ...state.joints.map((j) => el("span", j)));
  out.append(head);
  const most = Math.max(2, ...state.ladder.flatMap((r) => (r.joints || []).map((x) => x.ratio || 0)));
  state.ladder.forEach((r, k) => {
    const row = el("div", "", `rung${k === state.at ? " now" : ""}${k > state.at ? " gone" : ""}`);
    row.append(el("span", r.label, "name"));
    state.joints.forEach((j, i) => {
      const x = r.joints ? r.joints[i] : null, bar = el("div", "", `bar${x && x.ratio <= state.adequate ? " met" : ""}`);
      if (x) {
        const fill = el("i"); fill.style.width = `${(100 * x.ratio) / most}%`;
        bar.append(fill, el("b", `${x.ratio.toFixed(2)} (${x.relative.toFixed(1)} %)`));
        bar.setAttribute("role", "img"); bar.setAttribute("aria-label", `${r.label}, ${j}: ${x.ratio.toFixed(2)} times the floor, ${x.relative.toFixed(1)} %`);
      } else bar.append(el("b", "not compared yet"));
      row.append(bar);
    });
    out.append(row);
  });
}

function verdict() {
  const d = state.diagnosis;
  $("verdict").hidden = !d;
  if (!d) return;
  $("headline").textContent = d.text;
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

function draw() {
  const i = $("joint").selectedIndex, s = state.series, j = s.joints[i], unit = state.units[i];
  const y = `residual [${unit}]`;
  frame = plot($("residual"), { xs: range(s.t, 0), ys: range([...j.residual, j.floor, -j.floor]), xlabel: "time [s]", ylabel: y, band: j.floor, brush,
    layers: [{ x: s.t, y: j.residual, color: "--before", group: s.run }] });
  $("residual").setAttribute("aria-label", `Residual of ${state.joints[i]} over time; the band is the noise floor`);
  const keep = s.t.map((t) => !brush || (t >= brush[0] && t <= brush[1]));
  const part = (v) => v.filter((_, k) => keep[k]), residual = part(j.residual);
  const views = [["over-speed", j.speed, `speed [${state.motion[i]}/s]`, "speed"], ["over-position", j.position, `position [${state.motion[i]}]`, "position"], ["over-effort", j.effort, `effort [${unit}]`, "effort"]];
  for (const [id, values, label, name] of views) {
    const x = part(values);
    plot($(id), { xs: range(values), ys: range([...j.residual, j.floor, -j.floor]), xlabel: label, ylabel: y, band: j.floor, title: `over ${name}`,
      layers: [{ kind: "points", x, y: residual, color: "--before" }] });
    $(id).setAttribute("aria-label", `Residual of ${state.joints[i]} over ${name}`);
  }
  $("whole").hidden = !brush;
  $("brushed").textContent = brush ? `${brush[0].toFixed(2)} to ${brush[1].toFixed(2)} s` : "Drag over a part to see it alone in the views below.";
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
    row.append(el("td", c.effect), el("td", c.joint || "robot"), el("td", c.relative_after === null ? "-" : `${c.relative_after.toPrecision(3)} %`, "n"),
      el("td", c.confidence ? c.confidence.toFixed(2) : "-", "n"), el("td", c.meaning), last);
    return row;
  }));
}

function learnt() {
  $("learnt-part").hidden = !state.learnt.length;
  $("learnt").replaceChildren();
  for (const f of state.learnt) {
    const figure = el("figure"), canvas = el("canvas");
    canvas.setAttribute("height", 220); canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", `${f.effect} on ${f.joint}: data and law`);
    figure.append(canvas); $("learnt").append(figure);
    const unit = state.units[state.joints.indexOf(f.joint)];
    plot(canvas, { xs: range(f.x), ys: range([...f.data, ...f.law]), xlabel: f.label, ylabel: `effort [${unit}]`, title: `${f.effect} on ${f.joint}: data (grey), law (blue)`,
      layers: [{ x: f.x, y: f.data, color: "--data", width: 2.4 }, { x: f.x, y: f.law, color: "--after", width: 1.8 }] });
  }
}

function model() {
  const body = $("model").tBodies[0], plain = new Set();
  body.replaceChildren();
  for (const use of state.model) {
    use.values.forEach((v, k) => {
      const row = el("tr"), last = el("td", v.note);
      if (k === 0 && state.model.length > 1) {
        const b = el("button", "Remove"); b.type = "button"; b.setAttribute("aria-label", `Remove ${use.effect}`);
        b.onclick = () => ask("remove", { effect: use.effect }); last.append(" ", b);
      }
      row.append(el("td", k === 0 ? use.effect : ""), el("td", v.name), el("td", v.value === null ? "-" : String(v.value), "n"),
        el("td", v.half === null ? "-" : String(v.half), "n"), el("td", v.unit), last);
      body.append(row);
    });
  }
}

function notes() {
  $("warnings").replaceChildren(...(state.warnings.length ? state.warnings.map((w) => el("li", w)) : [el("li", "Nothing is wrong with the recording.")]));
  $("commands").textContent = state.commands.join("\n") || "Nothing was changed yet.";
}

// ------------------------------------------------------------ what the user does
$("undo").onclick = () => ask("undo");
$("redo").onclick = () => ask("redo");
$("diagnose").onclick = () => ask("diagnose");
$("take").onclick = () => ask("take");
$("cancel").onclick = () => call("/api/cancel", {});
$("joint").onchange = () => { draw(); places(); };
$("whole").onclick = () => { brush = null; draw(); };
$("save").onsubmit = (e) => { e.preventDefault(); ask("save", { path: $("path").value }); };
$("report").onsubmit = (e) => { e.preventDefault(); ask("report", { path: $("page").value }); };
const canvas = $("residual");
canvas.onpointerdown = (e) => { asked = frame.inverse(e.offsetX); canvas.setPointerCapture(e.pointerId); tab = 1; };
canvas.onpointermove = (e) => {
  if (!tab) return;
  const end = frame.inverse(e.offsetX);
  brush = [Math.min(asked, end), Math.max(asked, end)];
  draw();
};
canvas.onpointerup = () => { tab = 0; if (brush && brush[1] - brush[0] < 0.02) brush = null; draw(); };
canvas.onkeydown = (e) => {
  const t = state.series.t, whole = t[t.length - 1] - t[0], step = whole / 20;
  if (e.key === "Escape") brush = null;
  else if (e.key === "ArrowRight" || e.key === "ArrowLeft") {
    const d = e.key === "ArrowRight" ? step : -step;
    brush = brush ? [brush[0] + d, brush[1] + d] : [t[0], t[0] + 4 * step];
  } else return;
  e.preventDefault(); draw();
};
window.addEventListener("resize", () => state && (draw(), learnt()));
watch();
