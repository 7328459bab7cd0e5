// Rerun's viewer in a cell. Its two files come from the kernel's machine: from a server there, where the browser
// reaches its loopback, else through the kernel's connection. What they would ask of a network is refused.
const SECURE = "A picture only: Rerun's viewer needs an address that the browser trusts (https, or localhost).";
const HERE = "(request, options) => {\n" +
  "  const url = new URL(request.url ?? request, location.href);\n" +
  "  const near = [location.hostname, 'localhost', '127.0.0.1'].includes(url.hostname);\n" +
  "  return near || /^(blob|data):/.test(url.protocol) ? fetch(request, options)\n" +
  "    : Promise.reject(new TypeError('nothing from a network: ' + url.hostname));\n}";
const CALL = /= (?:arg0\.)?fetch\(/g;
const WASM = 'new URL("./re_viewer_bg.wasm", import.meta.url)';

function changed(model, name) {
  return new Promise((resolve) => {
    const take = () => {
      const value = model.get(name);
      if (!(value?.byteLength ?? value)) return; // bytes that are not there yet are an empty view
      model.off(`change:${name}`, take);
      resolve(value);
    };
    model.on(`change:${name}`, take);
    take();
  });
}

async function served(model) {
  model.set("wanted", "served");
  model.save_changes();
  const address = await changed(model, "address");
  const answer = await fetch(`${address}/widget.js`, { signal: AbortSignal.timeout(20000) });
  return [await answer.text(), `${address}/re_viewer_bg.wasm`];
}

async function inline(model) {
  model.set("wanted", "inline");
  model.save_changes();
  const [program, packed] = [await changed(model, "program"), await changed(model, "packed")];
  const wasm = new Response(new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip")));
  const typed = new Blob([await wasm.arrayBuffer()], { type: "application/wasm" });
  return [program, URL.createObjectURL(typed)];
}

async function load(model) {
  let files;
  try {
    files = await served(model);
    model.set("mode", "served");
  } catch {
    files = await inline(model);
    model.set("mode", "inline");
  }
  const [program, wasm] = files;
  if (!program.includes(WASM)) throw new Error("this release of rerun_notebook is not known");
  const text = program.replaceAll(WASM, `new URL(${JSON.stringify(wasm)})`).replace(CALL, "= fetchHere(");
  return import(URL.createObjectURL(new Blob([`const fetchHere = ${HERE};\n${text}`], { type: "text/javascript" })));
}

async function render({ model, el }) {
  const box = document.createElement("div");
  el.append(box);
  let end = () => {};
  try {
    if (!window.isSecureContext) throw new Error(SECURE);
    const viewer = await load(model);
    end = viewer.default.render({ model, el: box }) ?? end;
  } catch (error) {
    model.set("mode", "still");
    box.innerHTML = model.get("still") ? `<img style="max-width: 100%" src="data:image/png;base64,${model.get("still")}">` : "";
    box.append(Object.assign(document.createElement("p"), { textContent: error.message }));
  }
  model.save_changes();
  return () => end();
}

export default { render };
