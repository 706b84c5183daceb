// What all parts of the page share: elements, requests, and the wait for an answer.
const token = new URLSearchParams(location.search).get("token") || "";
export const $ = (id) => document.getElementById(id);

// every word of the data is set as text, never as markup
export function el(name, content = "", kind = "") {
  const e = document.createElement(name);
  if (content !== "") e.textContent = content;
  if (kind) e.className = kind;
  return e;
}

export async function call(path, body) {
  const options = { headers: { "X-Hil-Token": token } };
  if (body !== undefined) { options.method = "POST"; options.body = body instanceof Blob ? body : JSON.stringify(body); }
  const answer = await fetch(path, options);
  return answer.json();
}

export function say(text, error = false) {
  $("said").textContent = text;
  $("status").classList.toggle("error", error);
}

const DOING = {
  start: "Fitting the model", add: "Adding the effect and fitting again", remove: "Fitting without the effect",
  diagnose: "Diagnosing", take: "Fitting the recommended model", undo: "Going back", redo: "Going forward",
  go: "Showing the model", beside: "Comparing", save: "Saving", report: "Writing the report", export: "Fitting and writing the export",
  open: "Reading the file", preview: "Checking the picks", bring: "Bringing the session in", leave: "Closing the table", learn: "Checking and ranking your effect",
};
// how often a page that waits for nothing looks whether another tab asked for something [ms]
const IDLE = 1500;
const STRANGE = "This page belongs to a studio that has ended. Open the address that the new one printed.";
const GONE = "The studio does not answer. Is it still running?";
const wait = (ms) => new Promise((done) => setTimeout(done, ms));
let watching = false, looked = () => {}, known = -1, lost = false;
// what is shown of a request before it is done: the ladder with its model, then curves and parameters
export function early(look) { looked = look; }

// waits for the running request, then gives the page what there is now
export async function watch(shown) {
  if (watching) return;
  watching = true;
  const still = () => { for (const b of document.querySelectorAll("button:not(#cancel):not(#whole)")) b.disabled = true; };
  still();
  let now, more = null;
  for (;;) {
    try { now = await call("/api/status"); } catch { say(GONE, true); await wait(1000); continue; }
    if (now.error && now.running === undefined) { say(STRANGE, true); watching = false; return; }
    if (!now.running) break;
    $("cancel").hidden = false; $("share").hidden = false;
    $("share").value = now.share;
    say(`${DOING[now.running] || now.running}${now.doing ? `: ${now.doing}` : ""}. ${now.seconds.toFixed(0)} s`);
    if (now.looked && !more) more = await call("/api/look").catch(() => null);
    if (now.ladder.length) { looked(now.ladder, more); still(); }
    await wait(120);
  }
  $("cancel").hidden = $("share").hidden = true;
  let state, files;
  try { [state, files] = await Promise.all([call("/api/state"), call("/api/files")]); } catch { say(GONE, true); return; } finally { watching = false; }
  known = now.number; lost = false;
  for (const b of document.querySelectorAll("button")) b.disabled = false;
  const told = shown(state, files);
  say(now.error || now.note || (told ? `Ready. ${told}` : "Ready."), Boolean(now.error));
}

let after = () => {};
export function answered(shown) { after = shown; setInterval(look, IDLE); return watch(shown); }

// another tab may have asked for something, or the studio may have ended
async function look() {
  if (watching) return;
  let now;
  try { now = await call("/api/status"); } catch { if (!watching) say(GONE, true); lost = true; return; }
  if (now.running === undefined) { say(STRANGE, true); return; }
  if (!watching && (lost || now.running || now.number !== known)) await watch(after);
}

export async function ask(verb, more = {}) {
  let found;
  try { found = await call("/api/ask", { verb, ...more }); } catch { found = { error: GONE }; }
  if (found.error) { say(found.error, true); return; }
  await watch(after);
}

// a file to the folder in which the studio was started; its path
export async function send(file) {
  say(`Sending ${file.name}…`);
  let found;
  try { found = await call(`/api/file?name=${encodeURIComponent(file.name)}`, file); } catch { found = { error: GONE }; }
  if (found.error) { say(found.error, true); return ""; }
  return found.path;
}
