// The timeline: passes from left to right, resources from top to bottom, barriers as lines between the passes.

const ROW = 23;
const GROUP = 24;
const SVG = "http://www.w3.org/2000/svg";

function build(node, attributes, children) {
  for (const [name, value] of Object.entries(attributes ?? {})) {
    if (value !== null && value !== undefined && value !== false) node.setAttribute(name, value);
  }
  node.append(...children.flat().filter((child) => child !== null && child !== undefined));
  return node;
}
const h = (tag, attributes, ...children) => build(document.createElement(tag), attributes, children);
const s = (tag, attributes, ...children) => build(document.createElementNS(SVG, tag), attributes, children);

const tip = (text) => s("title", {}, text);

// SVG paths in a square of 24 x 24, by the kind of pass.
const ICONS = {
  dispatch: "M7 7h4v4H7zM13 7h4v4h-4zM7 13h4v4H7zM13 13h4v4h-4z",
  draw: "M12 6.5L18 17H6z",
  fill: "M7 7h10v10H7zM7 17L17 7M7 12l5-5M12 17l5-5",
  start: "M12 7a5 5 0 1 0 .01 0M12 12h.01",
  export: "M6 12h10M12 8l4 4-4 4M18.5 7v10",
  host: "M6 7h12v8H6zM10 18h4M12 15v3",
};

// Returns the mark of an access: a ring for a read, a square for a write, both for a read and a write.
function mark(kind, x, y, colour) {
  if (kind === "read") return s("circle", { class: "mark read", cx: x, cy: y, r: 4.6 });
  const square = s("rect", { class: "mark", x: x - 5, y: y - 5, width: 10, height: 10, rx: 1.5, fill: colour });
  if (kind === "write") return square;
  return s("g", {}, square, s("circle", { class: "mark read", cx: x, cy: y, r: 2.6 }));
}

// Returns the mark of a hazard on a barrier's line: filled for a read after write, hollow for the others.
function badge(hazard, x, y, image) {
  const full = hazard === "ReadAfterWrite" ? " full" : "";
  const d = image ? `M${x - 4} ${y - 4}h8v8h-8z` : `M${x} ${y - 5}L${x + 5} ${y}L${x} ${y + 5}L${x - 5} ${y}z`;
  return s("path", { class: `badge${full}`, d });
}

class Timeline {
  constructor(root) {
    this.root = root;
  }

  // Redraws everything. `state` has `folded` (a set of repeats' names) and `filter` (a text).
  draw(state) {
    const { columns, width } = makeColumns(state.folded);
    this.columns = columns;
    this.columnOf = new Map();
    for (const column of columns) {
      for (const pass of column.pass ? [column.pass, ...column.others] : []) this.columnOf.set(pass.name, column);
    }
    this.knobOf = new Map();
    for (const column of columns) {
      for (const knob of column.knobs)
        for (const barrier of knob.barriers) this.knobOf.set(barrier.id, { ...knob, column });
    }
    this.layRows(state.filter);
    const full = width + 84; // Labels lean to the right, over the last column.
    this.width = width;
    const head = this.drawHead(full);
    this.body = this.drawBody(full);
    const corner = h("div", { class: "corner", style: `height:${head.height}px` });
    for (const [y, text] of head.captions) corner.append(h("span", { style: `top:${y - 14}px` }, text));
    this.root.replaceChildren(h("div", { class: "grid" }, corner, head.svg, this.drawNames(), this.body));
  }

  layRows(filter) {
    const wanted = filter.trim().toLowerCase();
    const fits = (lane) =>
      [lane.name, ...lane.resources.map((r) => r.name)].some((name) => name.toLowerCase().includes(wanted));
    this.rows = [];
    this.rowOf = new Map();
    let y = 0;
    for (const group of groups) {
      const lanes = group.lanes.filter(fits);
      if (lanes.length === 0) continue;
      this.rows.push({ group, y, height: GROUP });
      y += GROUP;
      for (const lane of lanes) {
        const row = { lane, shared: group.shared, y, height: ROW, middle: y + ROW / 2 };
        this.rows.push(row);
        for (const resource of lane.resources) this.rowOf.set(resource.name, row);
        y += ROW;
      }
    }
    this.height = y + 10;
  }

  drawNames() {
    const names = h("div", { class: "names" });
    for (const row of this.rows) {
      const style = `height:${row.height}px`;
      const size = (n) => h("small", {}, bytes(n));
      if (row.group) {
        names.append(
          h(
            "div",
            { class: `group${row.group.shared ? " shared" : ""}`, style },
            row.group.title,
            size(row.group.bytes),
          ),
        );
      } else {
        const total = row.lane.resources.reduce((sum, r) => sum + r.bytes, 0);
        const select = `resource:${row.lane.resources[0].name}`;
        const attributes = {
          class: `lane${row.shared ? " shared" : ""}`,
          style,
          type: "button",
          "data-select": select,
        };
        names.append(h("button", attributes, h("span", { class: "mono" }, row.lane.name), size(total)));
      }
    }
    return names;
  }

  drawHead(full) {
    const timed = dump.passes.some((pass) => pass.gpu_ms !== null);
    const repeated = dump.repeats.length > 0;
    const captions = [];
    let y = 2;
    const row = (height, caption) => {
      y += height;
      captions.push([y, caption]);
      return y - height;
    };
    const sections = row(18, "");
    const phases = row(19, "phase");
    const repeatsAt = repeated ? row(21, "repeat") : y;
    const times = timed ? row(50, "GPU ms") : y;
    const labels = row(114, "pass") + 114;
    const boxes = row(30, "barrier") + 4;
    const height = y;
    const svg = s("svg", { class: "head", width: full, height });

    for (const run of runs(this.columns, (c) => c.section)) {
      const start = run[0].begins && run[0].left > 0 ? run[0].left + SECTION / 2 : 0;
      if (start > 0) svg.append(s("line", { class: "rule", x1: start, x2: start, y1: 0, y2: height }));
      const title = { prologue: "once", handover: "handover", frame: "every frame" }[run[0].section];
      const room = (run.at(-1).right - start) / 6;
      if (title.length <= room) svg.append(s("text", { x: start + 6, y: sections + 13, class: "quiet" }, title));
    }
    for (const run of runs(this.columns, (c) => (c.pass ? `${c.section} ${c.pass.phase}` : c))) {
      if (!run[0].pass) continue;
      const phase = run[0].pass.phase;
      const x = run[0].begins ? run[0].left + (run[0].left > 0 ? SECTION : 4) : run[0].left + 2;
      const wide = run.at(-1).right - x;
      svg.append(s("rect", { x, y: phases + 2, width: wide, height: 14, rx: 3, fill: colourOf(phase) }, tip(phase)));
      if (phase.length * 6.3 + 4 <= wide) {
        const style = `fill:${isLight(colourOf(phase)) ? "#111" : "#fff"}`;
        svg.append(s("text", { x: x + wide / 2, y: phases + 13, "text-anchor": "middle", style }, phase));
      }
    }
    for (const run of runs(this.columns, (c) => c.repeat ?? c)) {
      if (run[0].repeat) svg.append(this.drawRepeat(run, repeatsAt));
    }
    if (timed) svg.append(this.drawTimes(times, 48));
    for (const column of this.columns) {
      for (const knob of column.knobs) svg.append(this.drawKnob(knob, column, boxes + 11));
      if (column.pass) svg.append(this.drawColumn(column, labels, boxes));
    }
    return { svg, height, captions };
  }

  drawRepeat(run, y) {
    const repeat = run[0].repeat;
    const folded = run.some((column) => column.others.length > 0);
    const [x, right] = [run[0].left + 2, run.at(-1).right];
    const label = `${folded ? "▸" : "▾"} ${repeat.name} ×${repeat.iterations}`;
    const words = `${repeat.name}: ${repeat.iterations} iterations, ${repeat.passes} passes, ${folded ? "folded" : "unfolded"}`;
    const attributes = {
      class: "repeat",
      "data-fold": repeat.name,
      tabindex: 0,
      role: "button",
      "aria-label": words,
      "aria-expanded": String(!folded),
    };
    return s(
      "g",
      attributes,
      tip(`${words}; click to ${folded ? "unfold" : "fold"}`),
      s("rect", { x, y: y + 1, width: right - x, height: 17, rx: 4 }),
      s("text", { x: x + 6, y: y + 13 }, label),
    );
  }

  drawTimes(top, height) {
    const group = s("g", { class: "times" });
    const time = (column) =>
      [column.pass, ...column.others].reduce(
        (sum, pass) => (pass?.gpu_ms == null ? sum : (sum ?? 0) + pass.gpu_ms),
        null,
      );
    const most = Math.max(...this.columns.map((column) => time(column) ?? 0), 1e-9);
    for (const column of this.columns) {
      const ms = time(column);
      if (ms === null) continue;
      const tall = Math.max(1, (height - 14) * (ms / most));
      const merged = column.others.length > 0 ? `, sum of ${column.others.length + 1}` : "";
      group.append(
        s(
          "rect",
          {
            class: "time",
            x: column.x + 2,
            y: top + height - tall,
            width: COLUMN - 4,
            height: tall,
            fill: colourOf(column.pass.phase),
          },
          tip(`${column.pass.name}: ${milliseconds(ms)} ms${merged}`),
        ),
        s(
          "text",
          { x: column.x + COLUMN / 2, y: top + height - tall - 3, "text-anchor": "middle", style: "font-size:10px" },
          milliseconds(ms),
        ),
      );
    }
    return group;
  }

  drawColumn(column, labels, boxes) {
    const { pass, others } = column;
    const name = others.length > 0 ? pass.repeat.member + "[…]" : pass.name;
    const colour = colourOf(pass.phase);
    const middle = column.x + COLUMN / 2;
    const words = `pass ${name}, ${pass.kind}, phase ${pass.phase}`;
    const attributes = {
      class: `column ${isLight(colour) ? "light" : "dark"}`,
      "data-select": `pass:${pass.name}`,
      "data-passes": others.length + 1,
      tabindex: 0,
      role: "button",
      "aria-label": words,
    };
    const group = s("g", attributes, tip(`${words}\n${place(pass.declared)}`));
    const short = name.length > 20 ? `${name.slice(0, 19)}…` : name;
    group.append(s("text", { class: "label", transform: `translate(${middle + 3} ${labels - 4}) rotate(-52)` }, short));
    for (let i = Math.min(others.length, 2); i > 0; i--) {
      group.append(
        s("rect", { class: "stack", x: column.x + 2 * i, y: boxes - 2 * i, width: COLUMN, height: 22, rx: 4 }),
      );
    }
    group.append(
      s("rect", { class: "box", x: column.x, y: boxes, width: COLUMN, height: 22, rx: 4, fill: colour }),
      s("path", { class: "icon", d: ICONS[pass.kind], transform: `translate(${column.x} ${boxes - 1})` }),
    );
    return group;
  }

  // Returns the head of a barrier's line, the element that can have the focus.
  drawKnob(knob, column, y) {
    const [first] = knob.barriers;
    const image = !knob.merged && first.image !== null;
    const before = column.pass ? `before ${first.before.name}` : "between prologue and first frame";
    const words = knob.merged
      ? `${knob.barriers.length} barriers of the other iterations`
      : `barrier ${first.id}, ${image ? `layout of ${first.image.image}` : "on all memory"}, ${before}, ${first.dependencies.length} reasons`;
    const shape = image
      ? s("rect", { class: "knob", x: knob.x - 8.5, y: y - 8.5, width: 17, height: 17, rx: 2 })
      : s("circle", { class: "knob", cx: knob.x, cy: y, r: 8.8 });
    return s(
      "g",
      { ...this.knobAttributes(knob), tabindex: 0, role: "button", "aria-label": words },
      tip(words),
      shape,
      s(
        "text",
        { x: knob.x, y: y + 3.5, "text-anchor": "middle" },
        knob.merged ? `+${knob.barriers.length}` : first.id,
      ),
    );
  }

  knobAttributes(knob) {
    const [first] = knob.barriers;
    const kind = knob.merged ? "merged-barriers" : first.image ? "image" : "memory";
    const select = knob.merged ? `barriers:${knob.barriers.map((b) => b.id).join(",")}` : `barrier:${first.id}`;
    return { class: `barrier ${kind}`, "data-select": select };
  }

  drawBody(full) {
    const svg = s("svg", { class: "body", width: full, height: this.height });
    let odd = false;
    for (const row of this.rows) {
      odd = row.lane ? !odd : false;
      if (row.shared || row.group?.shared)
        svg.append(s("rect", { class: "sharedband", x: 0, y: row.y, width: full, height: row.height }));
      else if (row.lane && odd)
        svg.append(s("rect", { class: "zebra", x: 0, y: row.y, width: full, height: row.height }));
      if (row.group) svg.append(s("line", { class: "rule", x1: 0, x2: full, y1: row.y + 0.5, y2: row.y + 0.5 }));
      else
        svg.append(
          s("rect", {
            class: "lanehit",
            x: 0,
            y: row.y,
            width: full,
            height: row.height,
            "data-select": `resource:${row.lane.resources[0].name}`,
          }),
        );
    }
    for (const column of this.columns) {
      if (column.begins && column.left > 0) {
        const x = column.left + SECTION / 2;
        svg.append(s("line", { class: "rule", x1: x, x2: x, y1: 0, y2: this.height }));
      }
      if (column.pass)
        svg.append(
          s("rect", {
            class: "tint",
            x: column.x,
            y: 0,
            width: COLUMN,
            height: this.height,
            fill: colourOf(column.pass.phase),
            "pointer-events": "none",
          }),
        );
    }
    for (const row of this.rows.filter((r) => r.lane)) svg.append(this.drawLife(row));
    for (const column of this.columns) for (const knob of column.knobs) svg.append(this.drawLine(knob));
    for (const column of this.columns.filter((c) => c.pass)) svg.append(this.drawMarks(column));
    this.arcs = s("g", { class: "arcs" });
    const arrow = s(
      "marker",
      {
        id: "arrow",
        viewBox: "0 0 8 8",
        refX: 7,
        refY: 4,
        markerWidth: 8,
        markerHeight: 8,
        markerUnits: "userSpaceOnUse",
        orient: "auto",
      },
      s("path", { class: "tip", d: "M0 0L8 4L0 8z" }),
    );
    svg.append(s("defs", {}, arrow), this.arcs);
    return svg;
  }

  drawLife(row) {
    const [resource] = row.lane.resources;
    if (!resource.lifetime) {
      return s("line", {
        class: "longlife",
        x1: 0,
        x2: this.width,
        y1: row.middle,
        y2: row.middle,
        "pointer-events": "none",
      });
    }
    const [first, last] = [resource.lifetime.first, resource.lifetime.last].map((i) =>
      this.columnOf.get(dump.passes[i].name),
    );
    // In a folded repeat, a lifetime that spans iterations covers more columns: those after its first column, and all
    // columns of the repeat if it ends there.
    const ends = [first, last];
    for (const end of ends.slice()) {
      if (end.others.length > 0 && (first.repeat !== last.repeat || crosses(resource.lifetime))) {
        ends.push(...this.columns.filter((c) => c.repeat === end.repeat && (end === last || c.x > end.x)));
      }
    }
    const left = Math.min(...ends.map((c) => c.x));
    const right = Math.max(...ends.map((c) => c.right));
    const words = `${resource.name} lives from ${dump.passes[resource.lifetime.first].name} to ${dump.passes[resource.lifetime.last].name}`;
    return s(
      "rect",
      {
        class: "life",
        x: left - 2,
        y: row.middle - 8,
        width: right - left + 4,
        height: 16,
        rx: 8,
        "data-select": `resource:${resource.name}`,
      },
      tip(words),
    );
  }

  drawMarks(column) {
    const group = s("g", { "pointer-events": "none" });
    const kinds = (list) => {
      const found = new Map();
      for (const pass of list) {
        for (const [touches, bit] of [
          [pass.reads, 1],
          [pass.writes, 2],
        ]) {
          for (const { resource } of touches) {
            const row = this.rowOf.get(resource);
            if (row) found.set(row, (found.get(row) ?? 0) | bit);
          }
        }
      }
      return found;
    };
    const own = kinds([column.pass]);
    const all = kinds([column.pass, ...column.others]);
    const colour = colourOf(column.pass.phase);
    for (const [row, bits] of all) {
      const first = own.get(row);
      const shape = mark([null, "read", "write", "both"][first ?? bits], column.x + COLUMN / 2, row.middle, colour);
      group.append(s("g", first ? {} : { class: "merged" }, shape));
    }
    return group;
  }

  drawLine(knob) {
    const [first] = knob.barriers;
    const image = !knob.merged && first.image !== null;
    const group = s("g", this.knobAttributes(knob));
    group.append(
      s("rect", { class: "hit", x: knob.x - KNOB / 2, y: 0, width: KNOB, height: this.height }),
      s("line", { x1: knob.x, x2: knob.x, y1: 0, y2: this.height }),
    );
    const seen = new Set();
    for (const dependency of knob.barriers.flatMap((barrier) => barrier.dependencies)) {
      const row = this.rowOf.get(dependency.resource.name);
      if (!row || seen.has(row)) continue;
      seen.add(row);
      group.append(s("g", knob.merged ? { class: "merged" } : {}, badge(dependency.hazard, knob.x, row.middle, image)));
    }
    return group;
  }

  // Shows arcs for those dependencies of these barriers that `wanted` accepts.
  showArcs(list, wanted = () => true) {
    this.arcs.replaceChildren();
    for (const barrier of list) {
      for (const dependency of barrier.dependencies.filter((d) => wanted(d))) {
        for (const after of dependency.after) this.drawArc(dependency, after);
      }
    }
  }

  drawArc(dependency, after) {
    const source = this.columnOf.get(after.name);
    const target = this.columnOf.get(dependency.before.name);
    const middle = (column) => column.x + COLUMN / 2;
    const height = (name) => this.rowOf.get(name)?.middle ?? 4;
    const [x1, y1] = [middle(source), height(dependency.alias?.name ?? dependency.resource.name)];
    const [x2, y2] = [middle(target), height(dependency.resource.name)];
    // Arcs that run backwards bend down: from the previous frame, or between iterations of a folded repeat. All others
    // bend up.
    const back = dependency.previous_frame || x2 <= x1;
    const lift = (back ? 1 : -1) * Math.min(46, 12 + Math.abs(x2 - x1) / 9);
    const reach = (x2 - x1) / 4 + (x1 === x2 ? 26 : 0);
    const d = `M${x1} ${y1}C${x1 + reach} ${y1 + lift} ${x2 - reach} ${y2 + lift} ${x2} ${y2}`;
    const kind = dependency.previous_frame ? "before" : "";
    this.arcs.append(s("path", { class: "halo", d }), s("path", { class: kind, d, "marker-end": "url(#arrow)" }));
  }
}

// Returns true if a lifetime begins and ends in different iterations.
function crosses(lifetime) {
  const [first, last] = [dump.passes[lifetime.first], dump.passes[lifetime.last]];
  return String(first.repeat?.index) !== String(last.repeat?.index);
}

// Splits a list into runs of consecutive elements with equal keys.
function runs(list, key) {
  const found = [];
  for (const element of list) {
    const last = found.at(-1);
    if (last && key(last[0]) === key(element)) last.push(element);
    else found.push([element]);
  }
  return found;
}
