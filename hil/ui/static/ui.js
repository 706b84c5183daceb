// The operator's page: asks ten times a second, draws, and passes commands on.  Data is set as text.
import { plot, range } from "./plot.js";
import { above, space } from "./space.js";

const token = new URLSearchParams(location.search).get("token") || "";
// a page that is loaded anew is the same page, and goes on commanding; one that is opened, or made from it, is another
const KEPT_AS = "hil-page";
const before = JSON.parse(sessionStorage.getItem(KEPT_AS) || "{}");
sessionStorage.removeItem(KEPT_AS);
// not randomUUID, which only pages of this machine have
const page = before.page || [...crypto.getRandomValues(new Uint8Array(16))].map((x) => x.toString(16).padStart(2, "0")).join("");
window.addEventListener("pagehide", () => sessionStorage.setItem(KEPT_AS, JSON.stringify({ page, number })));
// shown again as it was: what was kept is in use
window.addEventListener("pageshow", (e) => { if (e.persisted) sessionStorage.removeItem(KEPT_AS); });
const $ = (id) => document.getElementById(id);
const KEPT = 400;
let number = before.number || 0, last = null, told = "", since = 0, seen = 0, named = "";
// silence of the program after which it counts as gone, and how long an emergency stop is repeated [ms]
const SILENCE = 5000, REPEATED = 10000;
// what went wrong with a command is shown for so long [ms]
const SHOWN = 8000;
// an answer that takes longer is told: what is shown is as old [ms]
const SLOW = 300;
let took = 0;
const track = { t: [], arms: {} };
const view = { turn: 0.5, lift: 0.35 };
let trail = [];

async function call(path, body) {
  const options = { headers: { "X-Hil-Token": token }, signal: AbortSignal.timeout(SILENCE) };
  if (body !== undefined) { options.method = "POST"; options.body = JSON.stringify({ page, ...body }); }
  return (await fetch(path, options)).json();
}

const LOST = "The command did not reach the program.";

async function ask(path, body = {}) {
  let found;
  try { found = await call(`/api/${path}`, body); } catch { found = { error: LOST, lost: true }; }
  told = found.error || ""; since = Date.now();
  return !found.lost;
}

// a number of its own makes a command that is sent twice done once
const say = (text) => ask("command", { text, number: ++number });

let stopping = false;
// an emergency stop is sent until the program has it
async function stop() {
  if (stopping) return;
  stopping = true;
  const body = { text: "stop", number: ++number }, until = Date.now() + REPEATED;
  while (!(await ask("command", body))) {
    told = "The emergency stop did not reach the program. Use the one in the power line.";
    gone();
    if (Date.now() > until) break;
    await new Promise((done) => setTimeout(done, 200));
  }
  stopping = false;
}

// the program is not there, or belongs to another page: what is shown is not known any more
function gone(why = "The program does not answer. A session that runs pauses by itself.") {
  $("state").textContent = "unknown"; $("state").dataset.level = "warn";
  $("recording").textContent = "unknown"; delete $("recording").dataset.level;
  $("next").textContent = told || why;
  $("status").classList.add("error");
  for (const b of document.querySelectorAll("main button[data-say], #take, #begin, #set button, #note button")) b.disabled = true;
}

// states in which a command does something
const FITS = { start: ["DISABLED"], pause: ["ENABLED"], resume: ["PAUSED"] };
const NEXT = {
  "": "The devices are opened. The first session of a rig compiles its program, which can take a minute.",
  DISABLED: "Press Start when everybody is clear of the arms.", ENABLED: "The law runs. Pause takes the torque away.",
  PAUSED: "Without torque. Resume begins where the arms are now.", FAULT: "Look at the reason, then begin a new session.",
};

function show(v) {
  last = v;
  if (Date.now() - since > SHOWN) told = "";
  const s = v.session, state = v.running ? s.state || "starting" : v.code === null ? "no session" : `ended (${v.code})`;
  $("rig").textContent = `Rig ${v.rig}`;
  $("record").textContent = v.record ? s.record || v.record : "";
  $("state").textContent = state;
  $("state").dataset.level = state === "ENABLED" ? "good" : state === "FAULT" || v.code > 0 ? "bad" : "warn";
  const reason = s.state === "PAUSED" && v.silent ? v.silent : s.state !== "ENABLED" && s.why;
  const watches = v.free ? "Nobody commands. Press Take command." : "Another page commands; this one watches. Everybody can press Emergency stop.";
  $("next").textContent = told || (v.running && !v.commands ? (reason ? `${reason}. ` : "") + watches : v.running ? (reason ? `${reason}. ` : "") + (NEXT[s.state || ""] || "") :
    s.state === "FAULT" && s.reason ? `The session ended in FAULT: ${s.reason}. ${NEXT.FAULT}` :
    (v.code === 0 ? "The session has ended: no torque, the record is closed. " : "") + (v.commands ? "Press New session." : v.free ? "Press Take command." : "Another page commands; this one watches."));
  $("status").classList.toggle("error", Boolean(told));
  $("take").disabled = v.commands || !v.free;
  $("begin").disabled = !v.commands || v.running;
  for (const b of document.querySelectorAll("[data-say], #set button, #note button"))
    b.disabled = !v.running || (!v.commands && b.dataset.say !== "stop") || (b.dataset.say in FITS && !FITS[b.dataset.say].includes(s.state));
  $("said").replaceChildren(...[...v.log.slice(-3), ...v.said.filter((x) => !x.startsWith("hil run: commands:")).slice(-4)].map((x) => { const e = document.createElement("li"); e.textContent = x.replace(/^hil run: /, ""); return e; }));
  settable(s.settable || {}, s.values || {});
  choices(v.joints || []);
  if (s.arms && v.number !== seen) { seen = v.number; keep(s, v.places || {}); draw(); }
  margin(v.margin);
  record(v.running, s, v.code !== null && v.record);
  devices(s.devices || []);
  health(s, v.disk || {});
}

// joints of this rig, to choose one of
function choices(joints) {
  const key = joints.map((j) => j.name).join();
  if (!joints.length || key === $("joint").dataset.key) return;
  $("joint").dataset.key = key;
  $("joint").replaceChildren(...joints.map((j, k) => { const o = document.createElement("option"); o.value = k; o.textContent = j.name; return o; }));
}

function margin(m) {
  $("margin").parentElement.hidden = !m || !m.text && !m.busy;
  if (!m) return;
  $("margin").dataset.level = m.level;
  $("margin").textContent = m.busy ? "margin: computing" : m.level === "good" ? "stable" : m.level === "bad" ? "not stable" : "margin";
  $("margin-text").textContent = m.text;
}

function record(running, s, closed) {
  const off = s.recording === false;
  $("recording").textContent = running && s.recording !== undefined ? (off ? "not recording" : "recording") : closed ? "record closed" : "no record";
  if (running && s.recording !== undefined) $("recording").dataset.level = off ? "warn" : "good"; else delete $("recording").dataset.level;
  $("switch").textContent = off ? "Record on" : "Record off";
  $("switch").dataset.say = off ? "record on" : "record off";
}

// state of a device -> how its lamp looks; every other one is quiet
const LEVELS = { ENABLED: "good", ANSWERS: "good", PAUSED: "warn", FAULT: "bad", LOST: "bad" };

function devices(all) {
  const told = JSON.stringify(all);
  if (!all.length || told === devices.told) return;
  devices.told = told;
  $("devices").replaceChildren(...all.map((d) => {
    const item = document.createElement("li"), lamp = document.createElement("span"), name = document.createElement("b"), why = document.createElement("span");
    lamp.className = "lamp"; lamp.textContent = d.state; if (LEVELS[d.state]) lamp.dataset.level = LEVELS[d.state];
    name.textContent = d.name; why.className = "quiet"; why.textContent = d.reason ? `${d.driver}: ${d.reason}` : d.driver;
    item.append(lamp, " ", name, " ", why); return item;
  }));
}

function scene() {
  if (!last) return;
  const places = last.places || {}, arms = last.session.arms || {};
  space($("space"), places, Object.fromEntries(Object.entries(arms).map(([n, a]) => [n, a.force])), view, last.gel);
  above($("above"), trail, $("hide").checked, last.gel);
}

function settable(all, values) {
  const box = $("name"), names = Object.keys(all);
  if (box.options.length !== names.length) box.replaceChildren(...names.map((n) => { const o = document.createElement("option"); o.value = o.textContent = n; return o; }));
  const r = all[box.value];
  const now = (values[box.value] || []).map((x) => +x.toPrecision(6)).join(" ");
  $("range").textContent = r ? `now ${now}; ${r.entries > 1 ? `${r.entries} numbers, ` : ""}${r.low} to ${r.high} ${r.unit}` : "";
  // what is in force is what is changed
  if (now && named !== box.value) { named = box.value; $("value").value = now; }
}

function keep(s, places) {
  // the arm of the gel; without one the last arm
  const names = Object.keys(places), name = last.gel ? last.gel.arm : names[names.length - 1];
  if (name in places) { const tip = places[name][places[name].length - 1]; trail.push([tip[0], tip[1], size(s.arms[name].force)]); if (trail.length > 600) trail.shift(); }
  if (track.t.length && s.seconds < track.t[track.t.length - 1]) { track.t = []; track.arms = {}; trail = []; }
  track.t.push(s.seconds);
  for (const [name, a] of Object.entries(s.arms)) (track.arms[name] ||= []).push(a);
  while (track.t.length > KEPT) { track.t.shift(); for (const a of Object.values(track.arms)) a.shift(); }
}

const size = (f) => Math.hypot(...f.map((x) => x || 0));
const COLORS = ["--before", "--after"];

function lines(id, values, ylabel) {
  const t = track.t;
  plot($(id), { xs: range(t, 0), ys: range(values.flat()), xlabel: "time [s]", ylabel, layers: values.map((y, k) => ({ x: t, y, color: COLORS[k], width: 1.6 })),
    title: values.length > 1 ? Object.keys(track.arms).map((name, k) => `${name} (${["orange", "blue"][k]})`).join(", ") : "" });
}

function draw() {
  scene();
  const arms = Object.entries(track.arms), j = Number($("joint").value), of = (last.joints || [])[j] || { unit: "rad", effort: "N m" };
  if (!arms.length) return;
  $("force").hidden = !arms.some(([, a]) => a[a.length - 1].sensed);
  if (!$("force").hidden) lines("force", arms.map(([, a]) => a.map((x) => size(x.force))), "force [N]");
  lines("position", arms.map(([, a]) => a.map((x) => x.position[j])), `position [${of.unit}]`);
  lines("effort", arms.map(([, a]) => a.map((x) => x.effort[j])), `effort [${of.effort}]`);
  $("error").parentElement.hidden = arms.length !== 2;
  if (arms.length === 2) lines("error", [arms[0][1].map((x, k) => x.position[j] - arms[1][1][k].position[j])], `${arms[0][0]} - ${arms[1][0]} [${of.unit}]`);
  $("forces").replaceChildren(...arms.map(([name, a]) => {
    const f = size(a[a.length - 1].force), e = document.createElement("span");
    e.className = "lamp"; e.textContent = `${name}: ${a[a.length - 1].sensed ? `${f.toFixed(2)} N` : "no force is measured"}`;
    // of the rig file, else of the sensor's range; 0 is none
    const [yellow, red] = a[a.length - 1].lamps;
    if (yellow || red) e.dataset.level = red && f >= red ? "bad" : yellow && f >= yellow ? "warn" : "good";
    return e;
  }));
}

const bytes = (n) => (n === undefined ? "-" : n >= 1e9 ? `${(n / 1e9).toFixed(1)} GB` : `${(n / 1e6).toFixed(1)} MB`);

function health(s, disk) {
  if (s.tick === undefined) return;
  const rows = { "time": `${s.seconds.toFixed(1)} s, tick ${s.tick}`, "wake-up late, p99": `${s.late_p99_us.toFixed(1)} us`, "missed deadlines": s.missed,
    "rows dropped": s.dropped, "most rows waiting": s.ring, "rows not written": s.unwritten, "rows left out": s.left_out, "hottest winding": `${s.winding.toFixed(0)} degC`, "size of the record": bytes(disk.record), "left on the disk": bytes(disk.free), "controller": s.controller,
    "answer to this page": `${(took / 1000).toFixed(2)} s${took > SLOW ? ", slow network" : ""}` };
  $("health").replaceChildren(...Object.entries(rows).map(([k, v]) => {
    const d = document.createElement("div"), a = document.createElement("dt"), b = document.createElement("dd");
    a.textContent = k; b.textContent = v; d.append(a, b); return d;
  }));
}

$("take").onclick = () => ask("take");
$("begin").onclick = () => ask("begin");
$("emergency").onclick = stop;
for (const b of document.querySelectorAll("[data-say]")) b.onclick = () => say(b.dataset.say);
$("set").onsubmit = (e) => { e.preventDefault(); say(`set ${$("name").value} ${$("value").value}`); };
$("note").onsubmit = (e) => { e.preventDefault(); say(`note ${$("text").value}`); $("text").value = ""; };
$("joint").onchange = draw;
$("hide").onchange = scene;
$("clear").onclick = () => { trail = []; scene(); };
const turn = (dx, dy) => { view.turn += dx; view.lift = Math.min(1.5, Math.max(-0.2, view.lift + dy)); scene(); };
$("space").onpointermove = (e) => { if (e.buttons) turn(-e.movementX / 150, e.movementY / 150); };
$("space").onkeydown = (e) => {
  const by = { ArrowLeft: [0.15, 0], ArrowRight: [-0.15, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] }[e.key];
  if (by) { e.preventDefault(); turn(...by); }
};
window.addEventListener("keydown", (e) => { if (e.key === "Escape") { e.preventDefault(); stop(); } });
window.addEventListener("resize", draw);

(async () => {
  for (;;) {
    const asked = performance.now();
    let v = null;
    try { v = await call(`/api/view?page=${page}`); } catch { gone(); }
    if (v && v.error) gone("This page belongs to a program that has ended. Open the address that the new one printed.");
    else if (v) { took = performance.now() - asked; show(v); }
    await new Promise((done) => setTimeout(done, 100));
  }
})();
