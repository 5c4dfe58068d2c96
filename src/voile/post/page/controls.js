"use strict";
// The page's controls: what the person chooses, the viewer shows.

function drawBar(data, hexes) {
  element("bar-title").textContent = (data.states ? data.name : data.title) + (data.unit ? ` [${data.unit}]` : "");
  const bar = element("bar-colours");
  const pen = bar.getContext("2d");
  hexes.forEach((hex, k) => {
    pen.fillStyle = hex;
    pen.fillRect(0, 256 - (256 * (k + 1)) / hexes.length, 1, 256 / hexes.length + 1);
  });
  const labels = element("bar-labels");
  labels.replaceChildren();
  const texts = data.states ?? [0, 1, 2, 3, 4].map((k) => short(data.low + (k / 4) * (data.high - data.low)));
  texts.forEach((text, k) => {
    const share = data.states ? (k + 0.5) / texts.length : k / 4;
    create("span", labels, text).style.bottom = `${100 * share}%`;
  });
}

function describe(viewer, picked) {
  const { step, field } = viewer.state;
  const data = viewer.fields.get(field);
  const index = data.location === "cell" ? picked.triangle : picked.own;
  const shade = data.values[step * data.data.columns + index];
  let value = "no value";
  if (data.states) value = data.states[Math.round((shade / 254) * (data.states.length - 1))];
  else if (shade < 255) {
    const bound = { 0: "at most ", 254: "at least " }[shade] ?? "about ";
    value = bound + Number((data.low + (shade / 254) * (data.high - data.low)).toPrecision(3)) + ` ${data.unit}`;
  }
  const at = [0, 1, 2].map((a) => short(viewer.points[3 * picked.vertex + a])).join(", ");
  return `vertex ${viewer.numbers[picked.own]} at (${at}) m: ${field.replaceAll("_", " ")} ${value}`;
}

function start(viewer) {
  const { meta } = viewer;
  const [slider, fieldBox, shapeBox] = ["step", "field", "shape"].map(element);
  const update = (change) => {
    const data = viewer.show(change);
    const { step } = viewer.state;
    slider.value = step;
    element("at").textContent = meta.steps[step];
    drawBar(data, meta.maps[data.map]);
    const extremes = data.extremes[step];
    element("extremes").textContent = extremes && !data.states
      ? `At this step: smallest ${short(extremes[0])}, largest ${short(extremes[1])} ${data.unit}` : "";
    element("picked").textContent = "";
    const cursor = element("cursor");
    if (cursor) {
      cursor.style.display = "block";
      cursor.style.left = `${100 * meta.cursor[step]}%`;
    }
  };
  for (const { name } of meta.fields) create("option", fieldBox, name.replaceAll("_", " ")).value = name;
  for (const [value, text] of [["step", "step"], ["start", "start"], ["rest", "rest shape, colours of the step"]])
    if (value === "step" || meta[value]) create("option", shapeBox, text).value = value;
  slider.max = meta.steps.length - 1;
  fieldBox.value = meta.field;
  slider.addEventListener("input", () => update({ step: Number(slider.value) }));
  fieldBox.addEventListener("change", () => update({ field: fieldBox.value }));
  shapeBox.addEventListener("change", () => {
    update({ shape: shapeBox.value });
    if (shapeBox.value === "rest") viewer.centre(viewer.points);
    else viewer.look("default");
  });
  for (const name of Object.keys(meta.views)) {
    const button = create("button", element("views"), name === "default" ? "home" : name);
    button.type = "button";
    button.addEventListener("click", () => viewer.look(name));
  }
  const toggle = (text, on, set) => {
    const label = create("label", element("toggles"));
    const box = create("input", label);
    box.type = "checkbox";
    box.checked = on;
    label.append(` ${text}`);
    box.addEventListener("change", () => {
      set(box.checked);
      viewer.draw();
    });
  };
  toggle("triangles", false, (on) => (viewer.shell.material.uniforms.meshLines.value = Number(on)));
  toggle("start's outline", viewer.startLines.visible, (on) => (viewer.startLines.visible = on));
  if (meta.bodies.length)
    toggle("obstacles", true, (on) => {
      viewer.withBodies = on;
      update({});
    });
  if (meta.reactions) toggle("reactions", viewer.arrows.visible, (on) => (viewer.arrows.visible = on));
  play(viewer, update);
  tellVertices(viewer);
  new ResizeObserver(() => viewer.resize()).observe(element("canvas"));
  update({ field: meta.field });
  viewer.resize();
  viewer.look("default");
}

function play(viewer, update) {
  const button = element("play");
  const last = viewer.meta.steps.length - 1;
  button.hidden = element("step").hidden = last === 0;
  let timer = null;
  const stop = () => {
    clearInterval(timer);
    timer = null;
    button.textContent = "\u25b6";
    button.title = "play";
  };
  button.addEventListener("click", () => {
    if (timer) return stop();
    if (viewer.state.step === last) update({ step: 0 });
    button.textContent = "\u275a\u275a";
    button.title = "pause";
    const pause = Math.min(500, Math.max(40, 8000 / (last + 1))); // ms: through all steps in about eight seconds
    timer = setInterval(() => (viewer.state.step < last ? update({ step: viewer.state.step + 1 }) : stop()), pause);
  });
}

/** A click, not a turn, tells the nearest vertex' values. */
function tellVertices(viewer) {
  const canvas = element("canvas");
  let pressed = [0, 0];
  canvas.addEventListener("pointerdown", (event) => (pressed = [event.clientX, event.clientY]));
  canvas.addEventListener("pointerup", (event) => {
    if (Math.hypot(event.clientX - pressed[0], event.clientY - pressed[1]) > 3) return;
    const box = canvas.getBoundingClientRect();
    const [x, y] = [(event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height];
    const picked = viewer.pick(2 * x - 1, 1 - 2 * y);
    element("picked").textContent = picked ? describe(viewer, picked) : "";
  });
}

function offerPattern() {
  const button = element("save-pattern");
  button?.addEventListener("click", () => {
    const text = new XMLSerializer().serializeToString(document.querySelector("#pattern svg"));
    const link = document.createElement("a");
    link.href = URL.createObjectURL(new Blob([text], { type: "image/svg+xml" }));
    link.download = "pattern.svg";
    link.click();
    URL.revokeObjectURL(link.href);
  });
}

(async () => {
  offerPattern();
  try {
    const meta = JSON.parse(element("page-data").textContent);
    start(new Viewer(meta, await readArrays()));
    element("message").textContent = "";
    document.documentElement.dataset.ready = "yes";
  } catch (error) {
    element("message").textContent = `The shell cannot be drawn: ${error.message}. A browser of 2023 or newer with WebGL is needed.`;
  }
})();
