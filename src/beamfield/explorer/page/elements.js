// What the page consists of.

// An element with properties and children; text never becomes markup.
export function make(tag, properties = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(properties)) {
    if (name.startsWith("aria-") || name === "role" || name === "for") element.setAttribute(name, value);
    else element[name] = value;
  }
  element.append(...children);
  return element;
}

export function button(text, title, pressed = null) {
  const made = make("button", { type: "button", textContent: text, title });
  if (pressed !== null) made.setAttribute("aria-pressed", String(pressed));
  return made;
}

const KEYS = "Arrow keys move the robot, square brackets turn it, with shift less; comma and full stop change the scan; " +
  "plus and minus zoom; n and b go to the next reading and back; h shows or hides the heat map; r returns to the reference pose.";

// One of two maps that show the same moment with two models.
function view(letter) {
  const canvas = make("canvas", { tabIndex: 0, role: "application", "aria-label": `Map ${letter} with the robot. ${KEYS}` });
  const caption = make("figcaption"), legend = make("ul", { className: "legend", "aria-label": `Colours of map ${letter}` });
  return { letter, canvas, caption, legend, figure: make("figure", {}, canvas, caption, legend) };
}

function section(name, title, ...children) {
  return make("section", { className: name, "aria-label": title }, make("h2", { textContent: title }), ...children);
}

export function build(root, hasPlace) {
  const page = {
    root,
    own: `beamfield-${Math.random().toString(36).slice(2)}`, // of several components in one notebook
    pose: make("span", { className: "pose" }),
    hint: make("span", { className: "hint", title: KEYS, textContent: "Drag the robot, or its dot to turn it: the table says how well the scan fits there. Point at a reading to see why." }),
    trouble: make("span", { className: "trouble", role: "alert" }),
    said: make("div", { className: "hidden", "aria-live": "polite" }),
    copy: button("Copy link", "Copy the address of this moment and pose"),
    views: [view("A"), view("B")],
    heat: button("Heat map", "How likely the scan is at places around the robot (h)", true),
    building: button("Whole building", "How likely the scan is over the whole map"),
    recorded: button("Recorded run", "Show or hide the filter's run that was given", true),
    filter: button("Run filter", "Run a particle filter with model A from this scan and pose on", false),
    reference: button("Reference", "Put the robot back to its reference pose (r)"),
    fit: button("Fit", "Show all of the robot's way"),
    scores: make("tbody"),
    beside: make("select", { "aria-label": "Beside it" }),
    verdict: make("p", { className: "verdict" }),
    sliders: make("div", { className: "sliders" }),
    judged: make("p", { className: "note judged" }),
    fitting: make("p", { className: "note" }),
    reset: button("Reset", "Set the values back to those of the set"),
    resetTo: make("select", { "aria-label": "Set the values to those of another set" }),
    download: button("Download file", "Save the values as a parameter file"),
    density: make("canvas", { className: "plot empty", role: "img", "aria-label": "Density of one reading" }),
    densityText: make("p", { className: "note", "aria-live": "polite", textContent: "Point at a reading on the map, or press n in it: the density of its range, what was measured, and its causes." }),
    play: button("Play", "Go through the log (space)"),
    scan: make("input", { type: "range", className: "scan", min: 0, step: 1, value: 0, "aria-label": "Scan" }),
    when: make("span", { className: "when" }),
    curve: make("select", { "aria-label": "Curve of the timeline" }),
    line: make("canvas", { className: "plot line", role: "img", "aria-label": "Timeline" }),
    worst: make("div", { className: "worst" }),
    lost: make("p", { className: "note lost" }),
  };
  page.copy.hidden = !hasPlace;
  const column = (text, title) => make("th", { scope: "col", textContent: text, title });
  const table = make("table", {}, make("thead", {}, make("tr", {},
    column("model", ""),
    column("log p", "log p(z | x, m) at the robot's pose, nats: only differences between poses can be compared"),
    column("over ref.", "nats more than at the reference pose: where it is positive, the model would draw a filter there"),
    column("pose score", "how well this scan tells the reference pose from others: log of the posterior's density over the prior's, nats; 0 says nothing, negative is sure of a wrong pose"),
  )), page.scores);
  root.replaceChildren(make("div", { className: "layout" },
    make("header", { className: "head" }, make("h1", { textContent: "beamfield explorer" }), page.pose, page.copy, page.hint, page.trouble, page.said),
    make("section", { className: "map", "aria-label": "Map" },
      make("div", { className: "tools" }, page.heat, page.building, page.recorded, page.filter, page.reference, page.fit),
      make("div", { className: "views" }, ...page.views.map((one) => one.figure))),
    make("section", { className: "time", "aria-label": "Time" },
      make("div", { className: "row" }, page.play, page.scan, page.when, page.curve), page.line, page.worst, page.lost),
    section("reading", "One reading", page.density, page.densityText),
    make("div", { className: "side" },
      section("models", "What each model says of this scan [nats]", table,
        make("div", { className: "row beside" }, make("span", { textContent: "Beside it", "aria-hidden": "true" }), page.beside), page.verdict),
      section("parameters", "Parameters of the chosen model", page.sliders, page.judged, page.fitting,
        make("div", { className: "row" }, page.reset, page.resetTo, page.download))),
  ));
  return page;
}
