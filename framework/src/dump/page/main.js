// The page's state, and how clicks, keys and the URL fragment change it.

const state = {
  folded: new Set(dump.repeats.filter((repeat) => repeat.passes > FOLD_OVER).map((repeat) => repeat.name)),
  filter: "",
  selected: null, // `{ kind, name }`
};
const $ = (id) => document.getElementById(id);
const timeline = new Timeline($("timeline"));

function fillHeader() {
  $("graph").textContent = dump.graph;
  $("summary").textContent = dump.summary;
  const total = dump.totals;
  const frameMs = dump.frame_ms ?? dump.gpu_ms;
  const tile = (value, label, title) => h("li", { title }, h("b", {}, value), h("span", {}, label));
  const saved = total.unshared_bytes > 0 ? Math.round((100 * total.saved_bytes) / total.unshared_bytes) : 0;
  $("totals").append(
    ...[
      frameMs !== null &&
        tile(
          `${milliseconds(frameMs)} ms`,
          "GPU per frame",
          dump.frame_ms === null ? "sum of the passes of the frame" : "from the first command to the last",
        ),
      tile(
        total.frame_passes + (total.prologue_passes > 0 ? ` + ${total.prologue_passes}` : ""),
        total.prologue_passes > 0 ? "passes + once" : "passes",
        "in every frame, and in the prologue",
      ),
      // There are no counts before a backend has added its barriers.
      barriers.length > 0 &&
        tile(
          total.frame.barriers,
          `barriers in ${total.frame.calls} calls`,
          `${total.frame.memory_barriers} on all memory, ${total.frame.image_barriers} on images`,
        ),
      barriers.length > 0 && tile(total.frame.dependencies, "reasons", "dependencies for which the frame's barriers were placed"),
      tile(bytes(total.transient_bytes), "own memory", "bytes of the memory blocks"),
      tile(
        bytes(total.saved_bytes),
        `saved by sharing (${saved}%)`,
        `${bytes(total.unshared_bytes)} if nothing were shared`,
      ),
      tile(bytes(total.scene_bytes), "scene", "attributes that the plan reads"),
    ].filter((node) => node),
  );
  for (const p of dump.parameters) {
    const changed = JSON.stringify(p.value) !== JSON.stringify(p.default);
    const because = p.reason
      ? `because ${Object.entries(p.reason.values).map(([name, value]) => `${name} = ${value}`).join(", ")}`
      : null;
    const effect = p.no_effect ? `no effect: ${p.no_effect}` : null;
    const notes = [because, changed ? `default ${p.default}` : null, p.live ? "live" : null, effect];
    const title = notes.filter((note) => note).join("; ");
    const value = h("b", { class: changed ? "changed" : null }, String(p.value));
    $("parameters").append(h("li", { title }, `${p.name} `, value, p.no_effect ? " (no effect)" : ""));
  }
  for (const name of phaseNames) {
    const times = dump.phases
      .filter((phase) => phase.name === name && phase.gpu_ms !== null)
      .map((phase) => phase.gpu_ms);
    const time = times.length > 0 ? ` ${milliseconds(times.reduce((a, b) => a + b))} ms` : "";
    $("phases").append(h("li", {}, h("span", { class: "swatch", style: `background:${colourOf(name)}` }), name + time));
  }
  const sample = (...nodes) => s("svg", { width: 18, height: 18 }, ...nodes);
  const line = (kind, ...nodes) =>
    sample(s("g", { class: `barrier ${kind}` }, s("line", { x1: 9, x2: 9, y1: 0, y2: 18 }), ...nodes));
  const grey = "#9aa0a6";
  const icons = [...new Set(dump.passes.map((pass) => pass.kind))].map((kind) => [
    s(
      "svg",
      { width: 20, height: 20, viewBox: "2 2 20 20" },
      s("g", {}, s("path", { class: "icon", d: ICONS[kind], style: "stroke:currentColor" })),
    ),
    kind,
  ]);
  const entries = [
    ...icons,
    [sample(mark("read", 9, 9)), "reads"],
    [sample(mark("write", 9, 9, grey)), "writes"],
    [sample(mark("both", 9, 9, grey)), "both"],
    [line("memory", badge("ReadAfterWrite", 9, 9)), "barrier: data dependency"],
    [line("memory", badge("WriteAfterRead", 9, 9)), "barrier: ordering only"],
    [line("image", badge("WriteAfterRead", 9, 9, true)), "image layout"],
  ];
  for (const [icon, text] of entries) $("legend").append(h("li", {}, icon, text));
  for (const id of ["fold-all", "unfold-all"]) $(id).hidden = dump.repeats.length === 0;
}

function redraw() {
  timeline.draw(state);
  showSelection();
}

// Selects `kind:name`, where kind is `barrier`, `barriers`, `pass` or `resource`. Any other text selects nothing.
function select(text, keepAddress) {
  const at = text.indexOf(":");
  const [kind, name] = [text.slice(0, at), text.slice(at + 1)];
  const content = at > 0 && PANELS[kind]?.(name);
  state.selected = content ? { kind, name } : null;
  $("panel").replaceChildren(...(content || overviewPanel()).flat().filter((node) => node));
  $("panel").scrollTop = 0;
  showSelection();
  if (!keepAddress) writeAddress();
}

const rest = () => {
  if (!state.selected) return timeline.showArcs([]);
  showArcsOf(`${state.selected.kind}:${state.selected.name}`);
};

function showArcsOf(select) {
  const at = select.indexOf(":");
  const [kind, name] = [select.slice(0, at), select.slice(at + 1)];
  const concerns = (d) => d.resource.name === name || d.alias?.name === name;
  if (kind === "barrier") timeline.showArcs([barrierById.get(name)]);
  else if (kind === "barriers") timeline.showArcs(name.split(",").map((id) => barrierById.get(id)));
  else if (kind === "pass")
    timeline.showArcs(barriers, (d) => d.before.name === name || d.after.some((p) => p.name === name));
  else if (kind === "resource") timeline.showArcs(barriers, concerns);
  else timeline.showArcs([]);
}

// Returns the timeline's elements for an item, such as a barrier's head and its line.
function elementsOf({ kind, name }) {
  let wanted = `${kind}:${name}`;
  if (kind === "pass") wanted = `pass:${timeline.columnOf.get(name)?.pass.name}`;
  if (kind === "resource") wanted = `resource:${timeline.rowOf.get(name)?.lane.resources[0].name}`;
  if (kind === "barrier") {
    const knob = timeline.knobOf.get(Number(name));
    if (knob?.merged) wanted = timeline.knobAttributes(knob)["data-select"];
  }
  return [...$("timeline").querySelectorAll("[data-select]")].filter(
    (e) => e.dataset.select === wanted && !e.classList.contains("life"),
  );
}

function showSelection() {
  for (const element of $("timeline").querySelectorAll(".selected")) element.classList.remove("selected");
  rest();
  if (!state.selected) return;
  const found = elementsOf(state.selected);
  for (const element of found) element.classList.add("selected");
  const main = found.find((e) => e.matches(".column, .head .barrier, .lane"));
  if (main) reveal(main);
}

// Scrolls an element into view, with some room. The names at the left and the passes at the top cover scrolled content.
function reveal(element) {
  const [view, box] = [$("timeline").getBoundingClientRect(), element.getBoundingClientRect()];
  const [left, room] = [view.left + 230, 110];
  if (!element.matches(".lane")) {
    if (box.left < left) $("timeline").scrollLeft += box.left - left - room;
    else if (box.right > view.right) $("timeline").scrollLeft += box.right - view.right + room;
  } else {
    const top = $("timeline").querySelector(".head").getBoundingClientRect().bottom;
    if (box.top < top) $("timeline").scrollTop += box.top - top - room;
    else if (box.bottom > view.bottom) $("timeline").scrollTop += box.bottom - view.bottom + room;
  }
}

function fold(name, folded) {
  for (const repeat of dump.repeats.filter((r) => name === "*" || r.name === name)) {
    if (folded) state.folded.add(repeat.name);
    else state.folded.delete(repeat.name);
  }
}

// --- The URL fragment: `#unfold=sort&barrier=3` ---------------------------------------------------------------------

function readAddress() {
  let selected = "";
  for (const part of location.hash.slice(1).split("&")) {
    const at = part.indexOf("=");
    if (at < 0) continue;
    const [key, raw] = [part.slice(0, at), part.slice(at + 1)];
    let value = raw;
    try {
      value = decodeURIComponent(raw);
    } catch {
      // A hand-written value with a lone `%` is used unchanged.
    }
    if (key === "unfold" || key === "fold") fold(value, key === "fold");
    else if (key in PANELS) selected = `${key}:${value}`;
  }
  timeline.draw(state);
  select(selected, true);
}

function writeAddress() {
  const parts = [];
  for (const repeat of dump.repeats) {
    const folded = state.folded.has(repeat.name);
    if (folded !== repeat.passes > FOLD_OVER)
      parts.push(`${folded ? "fold" : "unfold"}=${encodeURIComponent(repeat.name)}`);
  }
  if (state.selected) parts.push(`${state.selected.kind}=${encodeURIComponent(state.selected.name)}`);
  history.replaceState(null, "", `#${parts.join("&")}`);
}

// --- Clicks and keys ------------------------------------------------------------------------------------------------

function activate(element) {
  const target = element.closest("[data-select], [data-fold]");
  if (!target) return false;
  if (target.dataset.fold !== undefined) {
    fold(target.dataset.fold, !state.folded.has(target.dataset.fold));
    redraw();
    writeAddress();
  } else {
    select(target.dataset.select);
  }
  return true;
}

document.addEventListener("click", (event) => {
  if (activate(event.target)) event.preventDefault();
});

const hovered = (event) => event.target.closest?.("#timeline [data-select], #panel a[data-select]");
document.addEventListener("mouseover", (event) => {
  const target = hovered(event);
  for (const element of $("timeline").querySelectorAll(".hover")) element.classList.remove("hover");
  if (!target || target.matches(".lanehit")) return rest();
  const select = target.dataset.select;
  const at = select.indexOf(":");
  for (const element of elementsOf({ kind: select.slice(0, at), name: select.slice(at + 1) }))
    element.classList.add("hover");
  showArcsOf(select);
});

document.addEventListener("keydown", (event) => {
  if (event.target.matches("input")) return;
  if (event.key === "Escape") return select("");
  const isControl = event.target.matches("svg [data-select], svg [data-fold]");
  if (isControl && (event.key === "Enter" || event.key === " ")) {
    event.preventDefault();
    const again = event.target.dataset.fold;
    activate(event.target);
    if (again !== undefined)
      [...$("timeline").querySelectorAll("[data-fold]")].find((e) => e.dataset.fold === again)?.focus();
    return;
  }
  const step = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
  if (!step || event.altKey || event.ctrlKey || event.metaKey) return;
  // Move to the previous or next item of the same kind, from the focused or else the selected one.
  const head = [...$("timeline").querySelectorAll(".head .column, .head .barrier")];
  const current = isControl ? event.target : state.selected && elementsOf(state.selected).find((e) => head.includes(e));
  if (!current || !head.includes(current)) return;
  const kind = current.matches(".column") ? ".column" : ".barrier";
  const same = head.filter((e) => e.matches(kind));
  const next = same[same.indexOf(current) + step];
  if (!next) return;
  event.preventDefault();
  next.focus();
  select(next.dataset.select);
});

$("filter").addEventListener("input", (event) => {
  state.filter = event.target.value;
  redraw();
});
$("fold-all").addEventListener("click", () => (fold("*", true), redraw(), writeAddress()));
$("unfold-all").addEventListener("click", () => (fold("*", false), redraw(), writeAddress()));
addEventListener("hashchange", readAddress);

fillHeader();
readAddress();
