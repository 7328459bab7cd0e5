// A figure as SVG in the page: parts whose id begins with "press:" are pressed, the rest is looked at.
// Ctrl and wheel zoom around the pointer, a drag moves what is seen, a double click shows all again.
const PRESS = "press:";

function render({ model, el }) {
  const box = document.createElement("div");
  box.className = "sfglab-press";
  const style = document.createElement("style");
  style.textContent = `.sfglab-press [id^="${PRESS}"] { cursor: pointer }
    .sfglab-press [id^="${PRESS}"]:hover { opacity: 0.65 }
    .sfglab-press svg { width: 100%; height: auto; touch-action: none }`;
  el.append(style, box);
  let seen = null; // the part of the figure that is seen, as a viewBox
  let drag = null;
  const svg = () => box.querySelector("svg");
  const show = (view) => {
    seen = view;
    svg().setAttribute("viewBox", view.join(" "));
  };
  const whole = () => svg().dataset.whole.split(" ").map(Number);

  function draw() {
    box.innerHTML = model.get("svg");
    const figure = svg();
    figure.dataset.whole = figure.getAttribute("viewBox");
    figure.style.maxWidth = figure.getAttribute("width"); // in points: texts have their size
    figure.setAttribute("aria-label", model.get("alt"));
    figure.removeAttribute("width");
    figure.removeAttribute("height");
    for (const [part, text] of Object.entries(model.get("titles"))) {
      for (const shown of figure.querySelectorAll(`[id="${CSS.escape(PRESS + part)}"]`)) {
        const title = document.createElementNS("http://www.w3.org/2000/svg", "title");
        title.textContent = text;
        shown.prepend(title);
      }
    }
    if (seen) show(seen);
  }

  function at(event) {
    const frame = svg().getBoundingClientRect();
    return [(event.clientX - frame.x) / frame.width, (event.clientY - frame.y) / frame.height];
  }

  box.addEventListener("pointerup", (event) => { // no click comes where the figure was drawn anew meanwhile
    const { part, moved } = drag ?? {};
    drag = null;
    if (!part || moved || event.button) return;
    model.send(part.id.slice(PRESS.length));
  });
  box.addEventListener("wheel", (event) => {
    if (!event.ctrlKey && !event.metaKey) return; // the page scrolls
    event.preventDefault();
    const [x, y, width, height] = seen ?? whole();
    const factor = Math.exp(event.deltaY / 400);
    const [across, down] = at(event);
    show([x + across * width * (1 - factor), y + down * height * (1 - factor), width * factor, height * factor]);
  }, { passive: false });
  box.addEventListener("pointerdown", (event) => {
    const part = event.target.closest(`[id^="${PRESS}"]`);
    drag = { from: at(event), view: seen ?? whole(), moved: false, part };
  });
  box.addEventListener("pointermove", (event) => {
    if (!event.buttons) drag = null; // it ended elsewhere
    if (!drag || event.buttons !== 1) return;
    const [across, down] = at(event).map((value, i) => value - drag.from[i]);
    if (Math.hypot(across, down) < 0.01 && !drag.moved) return;
    drag.moved = true;
    const [x, y, width, height] = drag.view;
    show([x - across * width, y - down * height, width, height]);
  });
  box.addEventListener("dblclick", () => show(whole()));
  model.on("change:svg", draw);
  draw();
}

export default { render };
