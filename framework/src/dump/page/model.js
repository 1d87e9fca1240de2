// The dump, and the data derived from it before drawing: lookups, lanes, columns.

const dump = JSON.parse(document.getElementById("dump").textContent);

const HAZARDS = {
  ReadAfterWrite: "read after write",
  WriteAfterRead: "write after read",
  WriteAfterWrite: "write after write",
  LayoutChange: "layout change",
};

// Okabe and Ito's palette, safe for colour-blind readers, with grey for black. https://jfly.uni-koeln.de/color/
const COLOURS = ["#56b4e9", "#e69f00", "#009e73", "#cc79a7", "#f0e442", "#0072b2", "#d55e00", "#9aa0a6"];

// A repeat with more passes than this is initially folded.
const FOLD_OVER = 12;

const passes = new Map(dump.passes.map((pass, index) => [pass.name, { pass, index }]));
const resources = new Map(dump.resources.map((resource) => [resource.name, resource]));
const repeats = new Map(dump.repeats.map((repeat) => [repeat.name, repeat]));

// All barriers, in the order of their ids.
const barriers = [
  ...dump.passes.filter((pass) => pass.run === "Once").flatMap((pass) => pass.barriers),
  ...dump.handover,
  ...dump.passes.filter((pass) => pass.run !== "Once").flatMap((pass) => pass.barriers),
];
const barrierById = new Map(barriers.map((barrier) => [String(barrier.id), barrier]));

const phaseNames = [...new Set(dump.phases.map((phase) => phase.name))];
const colourOf = (phase) => COLOURS[phaseNames.indexOf(phase) % COLOURS.length];

// Returns true if black text has more contrast on this colour than white (relative luminance, WCAG 2).
function isLight(colour) {
  const channel = (at) => {
    const c = parseInt(colour.slice(at, at + 2), 16) / 255;
    return c <= 0.03928 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4;
  };
  return 0.2126 * channel(1) + 0.7152 * channel(3) + 0.0722 * channel(5) > 0.18;
}

function bytes(n) {
  if (n < 1024) return `${n} B`;
  if (n < 1 << 20) return `${(n / 1024).toFixed(1)} KiB`;
  if (n < 1 << 30) return `${(n / (1 << 20)).toFixed(1)} MiB`;
  return `${(n / (1 << 30)).toFixed(2)} GiB`;
}

const milliseconds = (ms) => (ms >= 10 ? ms.toFixed(1) : ms >= 1 ? ms.toFixed(2) : ms.toFixed(3));
const place = (origin) => `${origin.file}:${origin.line}:${origin.column}`;

// --- Lanes: one for each resource, or for all planes of an attribute; grouped by memory -----------------------------

function makeGroups() {
  const of = (...sources) => dump.resources.filter((r) => sources.includes(r.source));
  const sum = (list) => list.reduce((total, r) => total + r.bytes, 0);
  const single = (list) => list.map((r) => ({ name: r.name, resources: [r] }));
  const groups = [];
  const shared = dump.blocks.filter((block) => block.aliases.length > 1);
  for (const block of shared) {
    const aliases = block.aliases.map((name) => resources.get(name));
    aliases.sort((a, b) => (a.lifetime?.first ?? 0) - (b.lifetime?.first ?? 0));
    groups.push({
      title: `block ${block.id}, shared by ${aliases.length}`,
      bytes: block.bytes,
      shared: true,
      lanes: single(aliases),
    });
  }
  const inShared = new Set(shared.flatMap((block) => block.aliases));
  const alone = of("transient").filter((r) => !inShared.has(r.name));
  groups.push({ title: "each in its own memory", bytes: sum(alone), lanes: single(alone) });
  groups.push({ title: "the scene's", bytes: sum(of("scene")), lanes: byAttribute(of("scene")) });
  const host = of("frame", "given", "live", "readback");
  groups.push({ title: "the host's", bytes: sum(host), lanes: single(host) });
  return groups.filter((group) => group.lanes.length > 0);
}

// Returns the lanes of scene resources. The planes of an attribute are bound together, so they share a lane.
function byAttribute(list) {
  const lanes = new Map();
  for (const resource of list) {
    const lane = lanes.get(resource.from) ?? { resources: [] };
    lane.resources.push(resource);
    lanes.set(resource.from, lane);
  }
  for (const lane of lanes.values()) {
    const [first, count] = [lane.resources[0].name, lane.resources.length];
    lane.name = count > 1 ? `${first.replace(/\[\d+\]$/, "")}[0..${count - 1}]` : first;
  }
  return [...lanes.values()];
}

const groups = makeGroups();

// --- Columns: one for each pass, or for each member of a folded repeat ----------------------------------------------

const COLUMN = 24; // Width of a pass.
const KNOB = 19; // Width of a barrier in the gap before a pass.
const MARGIN = 8; // Width of a gap without barriers.
const SECTION = 20; // Additional gap between prologue, handover and frame.

// Returns the columns with their positions, and the total width. `folded` is the set of folded repeats' names.
function makeColumns(folded) {
  const columns = [];
  const members = new Map();
  let section = null;
  const begin = (name) => {
    const first = section !== name;
    section = name;
    return { section: name, begins: first, others: [], hidden: [] };
  };
  const handover = () => {
    if (dump.handover.length > 0) columns.push({ ...begin("handover"), pass: null, barriers: dump.handover });
  };
  let handed = false;
  for (const pass of dump.passes) {
    if (pass.run !== "Once" && !handed) {
      handed = true;
      handover();
    }
    const repeat = pass.repeat && repeats.get(pass.repeat.group);
    const key = repeat && folded.has(repeat.name) ? `${repeat.name}\n${pass.repeat.member}` : null;
    const shown = key && members.get(key);
    if (shown) {
      shown.others.push(pass);
      shown.hidden.push(...pass.barriers);
      continue;
    }
    const column = { ...begin(pass.run === "Once" ? "prologue" : "frame"), pass, barriers: pass.barriers, repeat };
    columns.push(column);
    if (key) members.set(key, column);
  }
  if (!handed) handover();

  let x = 0;
  for (const column of columns) {
    column.left = x;
    if (column.begins) x += x === 0 ? 4 : SECTION;
    const knobs = [...column.barriers.map((barrier) => ({ barriers: [barrier] }))];
    if (column.hidden.length > 0) knobs.push({ barriers: column.hidden, merged: true });
    x += MARGIN / 2;
    column.knobs = knobs.map((knob, i) => ({ ...knob, x: x + KNOB * (i + 0.5) }));
    x += KNOB * knobs.length + MARGIN / 2;
    column.x = x;
    column.width = column.pass ? COLUMN : 0;
    x += column.width;
    column.right = x;
  }
  return { columns, width: x + 6 };
}
