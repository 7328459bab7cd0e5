// A figure drawn by Vega. Python sends the specification once and values whenever they change.
const PATIENCE_MS = 150; // until a figure without an answer is shown as stale
const REST_MS = 200; // without a change, until points answer the mouse again
const LEAST_WIDTH = 140; // of a panel, px
const MOST_WIDTH = 320;
const ROW = 90; // between two rows of panels: an axis, and a title with its note, px
const SYMBOL = 28; // width of a legend's symbol with its space, px
const LETTER = 6;

async function unpack(packed) {
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
  const code = await new Response(stream).text();
  const address = URL.createObjectURL(new Blob([code], { type: "text/javascript" }));
  return (await import(address)).default;
}

async function embedOf(library) { // evaluated once in a page
  const loaded = (globalThis.sfglabVega ??= {});
  const key = library.get("key");
  loaded[key] ??= unpack(library.get("packed"));
  return loaded[key].catch((error) => {
    delete loaded[key]; // the next cell tries again
    throw error;
  });
}

async function render({ model, el, host, signal }) {
  const [status, box] = ["p", "div"].map((name) => el.appendChild(document.createElement(name)));
  el.classList.add("sfglab-vega");
  status.setAttribute("role", "status");
  const { hconcat, spacing } = model.get("spec");
  const panels = hconcat.length;
  const { domain } = hconcat[0].layer[0].encoding.color.scale;
  const entry = SYMBOL + LETTER * Math.max(...domain.map((name) => name.length));
  const layoutOf = (total) => { // square panels, so that a map is to scale
    let columns = Math.min(panels, Math.max(1, Math.floor(total / (spacing + LEAST_WIDTH))));
    while (panels % columns) columns -= 1;
    const width = Math.max(80, Math.min(MOST_WIDTH, Math.floor((total - 8) / columns - spacing)));
    return { columns, childWidth: width, height: width, entries: Math.max(1, Math.floor(total / entry)) };
  };
  const sized = (mark) => ({ // Vega keeps a group's size, and what it clips, if the size is no signal
    ...mark,
    marks: mark.marks?.map(sized),
    encode: mark.type === "group" ? { ...mark.encode, update: { ...mark.encode.update,
      width: { signal: "childWidth" }, height: { signal: "height" } } } : mark.encode,
  });
  let shownWidth = el.clientWidth; // 0 in a hidden tab
  const patch = (vega) => {
    const signals = Object.entries(layoutOf(shownWidth)).map(([name, value]) => ({ name, value }));
    const { height, ...others } = vega;
    return {
      ...others,
      signals,
      layout: { ...vega.layout, columns: { signal: "columns" }, padding: { row: ROW, column: spacing } },
      legends: vega.legends.map((legend) => ({ ...legend, columns: { signal: "entries" } })),
      marks: vega.marks.map(sized),
    };
  };
  let result;
  try {
    const embed = await embedOf(await host.getModel(model.get("library")));
    const spec = { ...model.get("spec"), datasets: { ...model.get("ghosts"), ...model.get("rows") } };
    const options = { actions: false, renderer: "svg", patch, tooltip: { theme: "sfglab" } };
    result = await embed(box, spec, options);
  } catch (error) {
    status.textContent = `The figure cannot be drawn: ${error}. Reload the page and run the cell again.`;
    return;
  }
  const { view, finalize } = result;
  const shown = {}; // rows by data set, as JSON; those that are equal are not drawn again
  const show = (sets) => {
    for (const [name, rows] of Object.entries(sets)) {
      const text = JSON.stringify(rows);
      if (shown[name] !== text) view.data(name, rows);
      shown[name] = text;
    }
  };
  const fit = () => {
    shownWidth = el.clientWidth;
    for (const [name, value] of Object.entries(layoutOf(shownWidth))) view.signal(name, value);
    view.resize();
  };
  const showHover = () => { // invisible points under the mouse; too slow for a drag
    const lines = Object.entries(model.get("rows")).filter(([name]) => name.startsWith("line"));
    show(Object.fromEntries(lines.map(([name, rows]) => [name.replace("line", "hover"), rows])));
    view.runAsync();
  };
  let rest = 0;
  const draw = async () => {
    if (!el.clientWidth) return; // a hidden tab
    show(model.get("ghosts"));
    show(model.get("rows"));
    if (el.clientWidth !== shownWidth) fit();
    view.description(model.get("said"));
    await view.runAsync();
    box.setAttribute("aria-label", model.get("said"));
    for (const dot of box.querySelectorAll(".mark-symbol [aria-label]")) dot.tabIndex = 0;
    clearTimeout(rest);
    rest = setTimeout(showHover, REST_MS);
  };
  let busy = false;
  let again = false;
  const redraw = async () => { // at once, and only the newest of what comes meanwhile
    again = true;
    if (busy) return;
    busy = true;
    while (again) {
      again = false;
      await draw().catch((error) => { status.textContent = `The figure cannot be drawn: ${error}`; });
    }
    busy = false;
  };

  let patience = 0;
  const tell = (late) => {
    const { of, is, why } = model.get("answer");
    const waits = late && model.get("asked") > of;
    const words = { coarse: " (coarse, computing ...)", refused: ` (an earlier setting): ${why}` };
    el.classList.toggle("stale", waits || is === "refused");
    status.textContent = model.get("said") + (waits ? " (computing ...)" : words[is] ?? "");
  };
  const wait = () => {
    patience ||= setTimeout(() => {
      patience = 0;
      tell(true);
    }, PATIENCE_MS);
  };
  model.on("change:asked", wait);
  model.on("change:answer", () => { clearTimeout(patience); patience = 0; tell(false); wait(); });
  model.on("change:rows", redraw);
  model.on("change:ghosts", redraw);

  const press = (item) => {
    const { place, x } = item?.datum ?? {};
    if (place !== undefined) model.send({ place, x });
  };
  view.addEventListener("pointerup", (_, item) => press(item)); // no click comes if it is redrawn meanwhile
  box.addEventListener("keydown", ({ key, target }) => key === "Enter" && press(target.__data__));
  const watch = new ResizeObserver(() => requestAnimationFrame(redraw));
  watch.observe(el);
  signal.addEventListener("abort", () => { watch.disconnect(); finalize(); });
  tell(false);
  redraw();
}

export default { render };
