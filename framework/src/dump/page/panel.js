// The side panel, which describes the selected item.

const link = (kind, name, text) =>
  h("a", { href: `#${kind}=${encodeURIComponent(name)}`, "data-select": `${kind}:${name}` }, text ?? name);
const origin = (declared) => h("span", { class: "origin" }, place(declared));
const quiet = (...children) => h("span", { class: "quiet" }, ...children);
const flags = (stages, accesses) =>
  h("span", { class: "flag" }, [stages.join(" | ") || "NONE", accesses.join(" | ")].filter((text) => text).join(" · "));
const joined = (nodes) => nodes.flatMap((node, i) => (i === 0 ? [node] : [", ", node]));
const row = (name, ...value) => h("tr", {}, h("th", {}, name), h("td", {}, ...value));
const table = (...rows) => h("table", {}, ...rows.filter((r) => r));

const barrierLink = (barrier) => link("barrier", barrier.id, `barrier ${barrier.id}`);

// Returns buttons that select the previous and the next item, and one that closes the panel.
function bar(kind, names, name) {
  const at = names.findIndex((n) => String(n) === String(name));
  const button = (label, target, title) =>
    target === undefined ? null : h("button", { type: "button", "data-select": `${kind}:${target}`, title }, label);
  return h(
    "div",
    { class: "bar" },
    button("◂", names[at - 1], "previous"),
    button("▸", names[at + 1], "next"),
    h("button", { type: "button", "data-select": "", title: "close (Escape)" }, "close"),
  );
}

const subjectOf = (barrier) =>
  barrier.image
    ? [`layout of `, link("resource", barrier.image.image), `: ${barrier.image.old} → ${barrier.image.new}`]
    : ["on all memory"];

function beforeOf(barrier) {
  if (!barrier.before) return [quiet("between the prologue and the first frame")];
  return ["before ", link("pass", barrier.before.name), " ", origin(barrier.before.declared)];
}

function barrierPanel(barrier) {
  return [
    bar(
      "barrier",
      barriers.map((b) => b.id),
      barrier.id,
    ),
    h("h2", {}, `Barrier ${barrier.id}`),
    h("p", {}, ...beforeOf(barrier)),
    h("p", {}, ...subjectOf(barrier)),
    h("h3", {}, "stages and accesses"),
    masks(barrier),
    h("h3", {}, `hazards resolved (${barrier.dependencies.length})`),
    ...barrier.dependencies.map((dependency) => dependencyCard(barrier, dependency)),
  ];
}

const masks = (of) =>
  table(
    row("from", flags(of.source_stages, of.source_accesses)),
    row("to", flags(of.target_stages, of.target_accesses)),
  );

function dependencyCard(barrier, d) {
  const title = h("h4", {}, `${HAZARDS[d.hazard]}: `, link("resource", d.resource.name));
  if (d.previous_frame) title.append(h("span", { class: "tag" }, "across frames"));
  if (d.alias) title.append(h("span", { class: "tag" }, "aliased memory"));
  const passOf = (p) => h("div", {}, link("pass", p.name), " ", origin(p.declared));
  const after = d.after.length > 0 ? d.after.map(passOf) : [quiet("not accessed before")];
  const before = [passOf(d.before)];
  let when = d.previous_frame ? "of the previous frame" : null;
  // The waiting pass is not the one right after the barrier: it runs later, or in the next frame.
  if (barrier.before && barrier.before.name !== d.before.name) {
    const next = passes.get(d.before.name).index < passes.get(barrier.before.name).index;
    if (next && d.previous_frame) when = "of this frame";
    before.push(quiet(`${next ? "of the next frame" : "later"}, without its own call`));
  }
  return h(
    "div",
    { class: "card" },
    title,
    table(
      row("after", ...after, when ? quiet(when) : null),
      row("", flags(d.source_stages, d.source_accesses)),
      row("before", ...before),
      row("", flags(d.target_stages, d.target_accesses)),
      barrier.image ? row("layouts", `${barrier.image.old} → ${barrier.image.new}`) : null,
      d.alias
        ? row("alias", link("resource", d.alias.name), " used the same memory ", origin(d.alias.declared))
        : null,
      row("declared", origin(d.resource.declared)),
    ),
  );
}

function afterRow(d) {
  const when = { Same: "", Prologue: " of the prologue", PreviousFrame: " of the previous frame" }[d.since];
  const alias = d.alias ? [" in the memory of ", link("resource", d.alias.name)] : [];
  return row(link("pass", d.pass.name), `${HAZARDS[d.hazard]}: `, link("resource", d.resource.name), ...alias, quiet(when));
}

function barriersPanel(ids) {
  const list = ids
    .split(",")
    .map((id) => barrierById.get(id))
    .filter((b) => b);
  const item = (b) =>
    h(
      "div",
      { class: "card" },
      h("h4", {}, barrierLink(b)),
      h("div", {}, ...beforeOf(b)),
      h("div", {}, ...b.dependencies.map((d) => h("div", {}, `${HAZARDS[d.hazard]}: ${d.resource.name}`))),
    );
  return [bar("barriers", [], ids), h("h2", {}, `${list.length} barriers of the other iterations`), ...list.map(item)];
}

function passPanel(pass) {
  const waiting = barriers.filter((b) => b.dependencies.some((d) => d.after.some((p) => p.name === pass.name)));
  const touches = (list) =>
    table(
      ...list.map((t) =>
        row(link("resource", t.resource), flags(t.stages, t.accesses), t.layout ? quiet(` ${t.layout}`) : null),
      ),
    );
  const section = (title, present, ...content) => (present ? [h("h3", {}, title), ...content] : []);
  const workgroup = (shader) =>
    [
      `workgroup of ${shader.local_size.join(" × ")}`,
      shader.shared_bytes > 0 ? `${bytes(shader.shared_bytes)} shared` : null,
    ]
      .filter((t) => t)
      .join(", ");
  const shader = (of) =>
    h(
      "div",
      { class: "card" },
      h("h4", {}, of.file),
      of.path && of.path !== of.file ? quiet(of.path) : null,
      pass.kind === "dispatch" ? quiet(workgroup(of)) : null,
      ...of.defines.map((d) => h("div", { class: "flag" }, `${d.name} = ${d.value}`)),
    );
  const index = pass.repeat ? `${pass.repeat.index.join(", ")} of ${pass.repeat.group}` : null;
  return [
    bar(
      "pass",
      dump.passes.map((p) => p.name),
      pass.name,
    ),
    h("h2", {}, pass.name),
    h("p", {}, origin(pass.declared)),
    table(
      row("kind", `${pass.kind}, ${pass.run === "Once" ? "once" : "every frame"}`),
      row("phase", pass.phase),
      index ? row("iteration", index) : null,
      pass.size ? row("size", pass.size) : null,
      pass.topology ? row("topology", pass.topology) : null,
      pass.gpu_ms !== null ? row("time", `${milliseconds(pass.gpu_ms)} ms on the GPU`) : null,
    ),
    ...section("shaders", pass.shaders.length, ...pass.shaders.map(shader)),
    ...section(
      "push constants",
      pass.push.length,
      table(...pass.push.map((p) => row(p.name ?? `byte ${p.offset}`, String(p.value)))),
    ),
    ...section(
      "targets",
      pass.targets.length,
      table(
        ...pass.targets.map((t) =>
          row(
            link("resource", t.image),
            `${t.load === "Keep" ? "kept" : `cleared to ${t.load.Clear.join(", ")}`}, ${t.blend}`,
          ),
        ),
      ),
    ),
    ...section(
      "depth",
      pass.depth ? 1 : 0,
      table(pass.depth ? row(link("resource", pass.depth.image), pass.depth.access.toLowerCase()) : null),
    ),
    ...section(
      "bindings",
      pass.bindings.length,
      table(
        ...pass.bindings.map((b) =>
          row(quiet(`${b.binding} ${b.name}${b.element > 0 ? `[${b.element}]` : ""}`), link("resource", b.resource)),
        ),
      ),
    ),
    ...section("reads", pass.reads.length, touches(pass.reads)),
    ...section("writes", pass.writes.length, touches(pass.writes)),
    ...section("comes after", pass.dependencies.length, table(...pass.dependencies.map(afterRow))),
    ...section("barriers before it", pass.barriers.length, h("div", {}, ...joined(pass.barriers.map(barrierLink)))),
    ...section("barriers that wait for it", waiting.length, h("div", {}, ...joined(waiting.map(barrierLink)))),
  ];
}

function resourcePanel(resource) {
  const users = (what) => dump.passes.filter((pass) => pass[what].some((t) => t.resource === resource.name));
  const concerned = barriers.filter((b) =>
    b.dependencies.some((d) => d.resource.name === resource.name || d.alias?.name === resource.name),
  );
  const block = dump.blocks.find((b) => b.id === resource.block);
  const aliases = block ? block.aliases.filter((name) => name !== resource.name) : [];
  const sources = {
    transient: "the plan's own",
    scene: `the scene's ${resource.from}`,
    frame: `written by the host: ${resource.from}`,
    given: `supplied by the host with every frame: ${resource.from}`,
    live: "live parameters, written by the host",
    readback: "read by the host",
  };
  const list = (title, found) => (found.length > 0 ? [h("h3", {}, title), h("div", {}, ...joined(found))] : []);
  const passAt = (index) => link("pass", dump.passes[index].name);
  let lifetime = [resource.freed ? "freed after the prologue" : "longer than a frame"];
  if (resource.lifetime) lifetime = [passAt(resource.lifetime.first), " to ", passAt(resource.lifetime.last)];
  return [
    bar(
      "resource",
      dump.resources.map((r) => r.name),
      resource.name,
    ),
    h("h2", {}, resource.name),
    h("p", {}, origin(resource.declared)),
    table(
      row("shape", resource.shape),
      row("bytes", `${resource.bytes.toLocaleString("en")} (${bytes(resource.bytes)})`),
      row("memory", sources[resource.source]),
      block ? row("block", `${block.id}, ${bytes(block.bytes)}`) : null,
      aliases.length > 0 ? row("shared with", ...joined(aliases.map((name) => link("resource", name)))) : null,
      row("lifetime", ...lifetime),
      resource.history ? row("history", resource.history) : null,
      row("usage", h("span", { class: "flag" }, resource.usage.join(" | "))),
      resource.name === dump.output ? row("", "the graph's output") : null,
    ),
    ...list(
      "written by",
      users("writes").map((pass) => link("pass", pass.name)),
    ),
    ...list(
      "read by",
      users("reads").map((pass) => link("pass", pass.name)),
    ),
    ...list("barriers placed for it", concerned.map(barrierLink)),
  ];
}

// Returns the panel's content while nothing is selected.
function overviewPanel() {
  const total = dump.totals;
  const ms = (n) => (n === null ? "" : `${milliseconds(n)} ms`);
  const phaseRow = (p) =>
    h(
      "tr",
      {},
      h(
        "th",
        {},
        h("span", { class: "swatch", style: `display:inline-block;background:${colourOf(p.name)}` }),
        ` ${p.name}`,
      ),
      h("td", {}, `${p.passes} ${p.passes === 1 ? "pass" : "passes"}${p.run === "Once" ? ", once" : ""}`),
      h("td", { class: "number" }, ms(p.gpu_ms)),
    );
  const timeRow = (name, time) =>
    h("tr", {}, h("th", {}, name), h("td", {}), h("td", { class: "number" }, time));
  const frame = dump.phases.filter((p) => p.run !== "Once" && p.gpu_ms !== null);
  const meter =
    dump.gpu_ms > 0
      ? h(
          "div",
          { class: "meter" },
          ...frame.map((p) =>
            h("div", { style: `flex:${p.gpu_ms};background:${colourOf(p.name)}`, title: `${p.name}: ${ms(p.gpu_ms)}` }),
          ),
        )
      : null;
  const counts = (name, of) =>
    h(
      "tr",
      {},
      h("th", {}, name),
      ...[of.calls, of.memory_barriers, of.image_barriers, of.dependencies].map((n) => h("td", { class: "number" }, n)),
    );
  const shared = dump.blocks.filter((b) => b.aliases.length > 1);
  return [
    h("h2", {}, "Overview"),
    h(
      "p",
      { class: "quiet" },
      "Select a pass, a barrier or a resource. Tab and the arrow keys move, Enter selects, Escape closes.",
    ),
    h("h3", {}, "phases"),
    meter,
    table(
      ...dump.phases.map(phaseRow),
      dump.gpu_ms === null || dump.frame_ms === null
        ? null
        : timeRow("unattributed", ms(Math.max(0, dump.frame_ms - dump.gpu_ms))),
      dump.gpu_ms === null ? null : timeRow("frame", h("b", {}, ms(dump.frame_ms ?? dump.gpu_ms))),
    ),
    h("h3", {}, "barriers"),
    table(
      h(
        "tr",
        {},
        h("th", {}),
        ...["calls", "memory", "image", "reasons"].map((t) => h("td", { class: "number quiet" }, t)),
      ),
      counts("prologue", total.prologue),
      counts("handover", total.handover),
      counts("frame", total.frame),
    ),
    ...(dump.warnings.length > 0
      ? [
          h("h3", {}, "warnings"),
          ...dump.warnings.map((w) => h("p", {}, `${w.message}; ${w.help.join("; ")} `, origin(w.declared))),
        ]
      : []),
    h("h3", {}, "memory"),
    table(
      row("without sharing", bytes(total.unshared_bytes)),
      row("with sharing", `${bytes(total.transient_bytes)} in ${dump.blocks.length} blocks`),
      row("saved", bytes(total.saved_bytes)),
      row("the scene's", bytes(total.scene_bytes)),
      row("the host's", `${bytes(total.host_bytes)} for each frame in flight`),
    ),
    ...shared.map((b) =>
      h(
        "div",
        { class: "card" },
        h("h4", {}, `block ${b.id}, ${bytes(b.bytes)}`),
        ...joined(b.aliases.map((name) => link("resource", name))),
      ),
    ),
    ...(dump.stats.length > 0
      ? [
          h("h3", {}, "statistics"),
          table(...dump.stats.map((stat) => row(stat.name, link("resource", stat.buffer), ` + ${stat.offset}`))),
        ]
      : []),
    ...(dump.left_out.length > 0
      ? [
          h("h3", {}, `left out: ${dump.left_out.length} passes`),
          ...dump.left_out.map((l) =>
            h("p", {}, h("span", { class: "mono" }, l.pass), `: ${l.why} `, origin(l.declared)),
          ),
        ]
      : []),
    h("h3", {}, "facts"),
    table(...Object.entries(dump.facts).map(([name, value]) => row(name, String(value)))),
  ].filter((node) => node);
}

const PANELS = {
  barrier: (id) => barrierById.has(id) && barrierPanel(barrierById.get(id)),
  barriers: (ids) => barriersPanel(ids),
  pass: (name) => passes.has(name) && passPanel(passes.get(name).pass),
  resource: (name) => resources.has(name) && resourcePanel(resources.get(name)),
};
