// A table that was dropped: what each column is, picked by hand, and what is wrong with the recording.
import { $, ask, el, send } from "./page.js";

let table = null, kinds = [];

function select(options, chosen, label) {
  const box = el("select");
  for (const [value, text] of options) {
    const o = el("option", text); o.value = value; o.selected = value === chosen; box.append(o);
  }
  box.setAttribute("aria-label", label);
  return box;
}

function units(stem) { return (kinds.find((k) => k.stem === stem) || { units: [] }).units.map((u) => [u, u]); }

function row(c, most) {
  const r = el("tr");
  const kind = select([["", "not used"], ...kinds.map((k) => [k.stem, k.name])], c.guess.kind, `${c.name} is`);
  const joint = select(Array.from({ length: most }, (_, k) => [String(k + 1), `joint ${k + 1}`]), String(c.guess.joint), `joint of ${c.name}`);
  let unit = select(units(c.guess.kind), c.guess.unit, `unit of ${c.name}`);
  const flip = el("input"); flip.type = "checkbox"; flip.setAttribute("aria-label", `opposite sign of ${c.name}`);
  const fit = () => {
    const of = kind.value;
    const fresh = select(units(of), unit.value, `unit of ${c.name}`);
    unit.replaceWith(fresh); unit = fresh; unit.onchange = stale;
    joint.hidden = !of || of === "t"; unit.hidden = !of; flip.hidden = !of || of === "t";
    r.classList.toggle("unused", !of);
    stale();
  };
  kind.onchange = fit; joint.onchange = flip.onchange = stale;
  const name = el("th", c.name); name.scope = "row";
  const values = el("td", c.first.map((x) => (x === null ? "–" : x)).join("  "), "values");
  const range = el("td", c.low === null ? "–" : `${c.low} to ${c.high}`, "values");
  if (c.missing) range.append(", ", el("span", `${c.missing} missing`, "bad"));
  const cells = [kind, joint, unit, flip].map((x) => { const d = el("td"); d.append(x); return d; });
  r.append(name, values, range, ...cells);
  fit();
  r.picked = () => (kind.value ? { column: c.name, kind: kind.value, joint: Number(joint.value) || 1, unit: unit.value, flip: flip.checked } : null);
  return r;
}

function stale() { $("bring").disabled = true; $("found").hidden = true; constant(); }

function constant() {
  const all = picks().columns;
  $("constant-part").hidden = !all.some((c) => c.kind === "tau" && ["A", "mA"].includes(c.unit));
  $("rate-part").hidden = all.some((c) => c.kind === "t");
}

function picks() {
  const columns = [...$("columns").tBodies[0].rows].map((r) => r.picked && r.picked()).filter(Boolean);
  return { columns, urdf: $("urdf").value, constant: $("constant").value, rate: $("rate").value, missing: $("missing").value };
}

export function files(state, found) {
  const open = found.intake;
  $("intake").hidden = !open;
  $("begin").hidden = Boolean(state) || Boolean(open);
  $("use").hidden = $("use-label").hidden = !state;
  if (!open) { table = null; return; }
  if (open.file !== table) {
    table = open.file; kinds = open.kinds;
    $("table-name").textContent = `${open.file}: what is each column?`;
    $("columns").tBodies[0].replaceChildren(...open.columns.map((c) => row(c, Math.max(1, Math.min(open.columns.length, 32)))));
    $("output").value = open.output;
    stale();
    $("h-intake").focus();
  }
  preview(found.preview);
}

function preview(p) {
  $("found").hidden = !p;
  $("bring").disabled = !p || !p.good;
  if (!p) return;
  $("found-text").textContent = p.text;
  const rows = [...p.faults.map((f) => el("li", f.text, f.severity === "error" ? "bad" : "")), ...p.notes.map((n) => el("li", n))];
  if (p.unused.length) rows.push(el("li", `Not used: ${p.unused.join(", ")}.`));
  $("found-faults").replaceChildren(...(rows.length ? rows : [el("li", "Nothing is wrong with the recording.")]));
}

async function take(list) {
  for (const file of list) {
    const path = await send(file);
    if (path) await ask("open", { path, use: $("use").hidden ? "new" : $("use").value });
  }
}

export function start() {
  $("check").onclick = () => ask("preview", { picks: JSON.stringify(picks()) });
  $("bring").onclick = () => ask("bring", { picks: JSON.stringify(picks()), output: $("output").value, use: $("use").hidden ? "new" : $("use").value });
  $("leave").onclick = () => ask("leave");
  for (const id of ["urdf", "constant", "rate", "missing"]) $(id).oninput = () => { $("bring").disabled = true; $("found").hidden = true; };
  for (const id of ["file", "file-first"]) $(id).onchange = (e) => { take([...e.target.files]); e.target.value = ""; };
  $("by-path").onsubmit = (e) => { e.preventDefault(); ask("open", { path: $("file-path").value, use: "new" }); };
  document.addEventListener("dragover", (e) => { e.preventDefault(); document.body.classList.add("over"); });
  document.addEventListener("dragleave", (e) => { if (!e.relatedTarget) document.body.classList.remove("over"); });
  document.addEventListener("drop", (e) => { e.preventDefault(); document.body.classList.remove("over"); take([...e.dataTransfer.files]); });
}
