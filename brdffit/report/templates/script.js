"use strict";
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const make = (tag, properties = {}, ...children) => {
    const node = Object.assign(document.createElement(tag), properties);
    node.append(...children);
    return node;
  };
  const svgNode = (tag, attributes, text) => {
    const node = document.createElementNS("http://www.w3.org/2000/svg", tag);
    for (const [name, value] of Object.entries(attributes)) node.setAttribute(name, value);
    if (text !== undefined) node.textContent = text;
    return node;
  };
  const press = (buttons, chosen) =>
    buttons.forEach((button) => button.setAttribute("aria-pressed", String(button === chosen)));
  const base = (method) => method.split(",")[0];
  const colour = (method) => (method === "reference" ? "#111827" : data.colours[base(method)] || "#333333");
  const decibels = (value) => (Math.abs(value) >= 99 ? (value > 0 ? "∞" : "−∞") : value.toFixed(1).replace("-", "−"));

  function viewer(root, set) {
    const state = { view: set.views[0], left: data.fit, right: "reference", gain: 4 };
    const picture = (name) => (name === "reference" ? state.view.reference : state.view.methods[name]);
    const under = make("img", { alt: "" });
    const over = make("img", { alt: "", className: "over" });
    const tagLeft = make("span", { className: "tag l" });
    const tagRight = make("span", { className: "tag r" });
    const stack = make("div", { className: "stack" }, under, over, make("div", { className: "bar" }), tagLeft, tagRight);
    const slider = make("input", { type: "range", min: 0, max: 100, value: 50 });
    slider.setAttribute("aria-label", "where the left picture ends and the right one begins, in percent");
    const cut = (percent) => {
      slider.value = percent;
      stack.style.setProperty("--cut", percent + "%");
    };
    slider.addEventListener("input", () => cut(slider.value));
    const drag = (event) => {
      if (event.type === "pointermove" && !event.buttons) return;
      const box = stack.getBoundingClientRect();
      cut(Math.max(0, Math.min(100, (100 * (event.clientX - box.left)) / box.width)));
    };
    stack.addEventListener("pointerdown", drag);
    stack.addEventListener("pointermove", drag);

    const select = (side, label) => {
      const node = make("select");
      node.addEventListener("change", () => { state[side] = node.value; draw(); });
      return { node, field: make("label", {}, label + " ", node) };
    };
    const left = select("left", "left");
    const right = select("right", "right");
    const gain = make("select", {}, ...[1, 2, 4, 8, 16].map((x) => make("option", { value: x, textContent: "× " + x, selected: x === 4 })));
    gain.addEventListener("change", () => { state.gain = Number(gain.value); difference(); });
    const canvas = make("canvas");
    canvas.setAttribute("role", "img");
    const differenceText = make("span");
    const viewButtons = set.views.map((view) => {
      const button = make("button", { type: "button", textContent: view.title });
      button.addEventListener("click", () => { state.view = view; draw(); });
      return button;
    });
    const shots = make("div", { className: "shots" });
    root.querySelector(".views").append(...viewButtons);
    root.querySelector(".bench").append(
      make("div", { className: "pane" }, make("div", { className: "controls" }, left.field, right.field), stack, slider),
      make("div", { className: "pane" },
        make("div", { className: "controls" }, differenceText, make("label", {}, "amplified ", gain)), canvas)
    );
    root.querySelector(".all").append(shots);

    const load = (source) => new Promise((done) => {
      const image = new Image();
      image.onload = () => done(image);
      image.src = source;
    });
    async function difference() {
      const names = [state.left, state.right];
      const [a, b] = await Promise.all(names.map((name) => load(picture(name))));
      if (names[0] !== state.left || names[1] !== state.right) return;
      canvas.width = a.width;
      canvas.height = a.height;
      const context = canvas.getContext("2d", { willReadFrequently: true });
      const pixels = [a, b].map((image) => {
        context.drawImage(image, 0, 0);
        return context.getImageData(0, 0, a.width, a.height);
      });
      const out = pixels[0];
      for (let i = 0; i < out.data.length; i += 4)
        for (let k = 0; k < 3; k++)
          out.data[i + k] = state.gain * Math.abs(pixels[0].data[i + k] - pixels[1].data[i + k]);
      context.putImageData(out, 0, 0);
      const text = `difference of ${state.left} and ${state.right}`;
      differenceText.textContent = text;
      canvas.setAttribute("aria-label", `${text}, amplified ${state.gain} times`);
    }

    function draw() {
      const names = ["reference", ...Object.keys(state.view.methods)];
      for (const side of ["left", "right"])
        if (!names.includes(state[side])) state[side] = names.includes(base(state[side])) ? base(state[side]) : names[1];
      for (const [side, chooser] of [["left", left], ["right", right]]) {
        chooser.node.replaceChildren(...names.map((name) => make("option", { value: name, textContent: name })));
        chooser.node.value = state[side];
      }
      press(viewButtons, viewButtons[set.views.indexOf(state.view)]);
      under.src = picture(state.left);
      under.alt = `${state.view.title}, by ${state.left}`;
      over.src = picture(state.right);
      over.alt = `${state.view.title}, by ${state.right}`;
      tagLeft.textContent = state.left;
      tagRight.textContent = state.right;
      shots.replaceChildren(...names.map((name) => {
        const caption = name === "reference" ? "every point lit, then filtered" : state.view.captions[name];
        const button = make("button", { type: "button" },
          make("img", { src: picture(name), alt: "" }), make("span", {}, make("b", { textContent: name }), caption));
        button.setAttribute("aria-pressed", String(name === state.left));
        button.addEventListener("click", () => { state.left = name; draw(); });
        return button;
      }));
      root.querySelectorAll("[data-view]").forEach((table) => { table.hidden = table.dataset.view !== state.view.key; });
      difference();
    }
    draw();
  }

  function lobes(root, set) {
    if (!set.lobes.length) return;
    const levels = [...new Set(set.lobes.map((lobe) => lobe.level))];
    const state = { lobe: set.lobes[Math.floor(set.lobes.length / 2)], shown: new Set([data.fit, "naive"]) };
    const levelButtons = levels.map((level) => {
      const button = make("button", { type: "button", textContent: "level " + level });
      button.addEventListener("click", () => {
        const away = (lobe) => Math.hypot(lobe.u - state.lobe.u, lobe.v - state.lobe.v);
        const same = set.lobes.filter((lobe) => lobe.level === level);
        state.lobe = same.reduce((best, lobe) => (away(lobe) < away(best) ? lobe : best));
        draw();
      });
      return button;
    });
    root.querySelector(".levels").append(...levelButtons);
    const where = root.querySelector(".where");
    const heats = root.querySelector(".heats");
    const cuts = root.querySelector(".cuts");
    const text = root.querySelector(".texel");
    where.append(make("img", { src: set.overview, alt: "the whole set under small lights" }));

    function plot(which, title) {
      const [width, height, pad] = [420, 210, 30];
      const svg = svgNode("svg", { viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": title });
      const names = ["reference", ...data.order.filter((name) => state.shown.has(name) && state.lobe.cuts[name])];
      const top = Math.min(3, Math.max(1.05, ...names.map((name) => Math.max(...state.lobe.cuts[name][which]))));
      const y = (value) => height - pad - ((height - pad - 18) * Math.min(value, top)) / top;
      const count = state.lobe.cuts.reference[which].length;
      const x = (i) => pad + ((width - pad - 8) * i) / (count - 1);
      svg.append(svgNode("text", { x: pad, y: 12, "font-size": 12, fill: "#111827" }, title));
      svg.append(svgNode("path", { d: `M${pad} ${y(0)}H${width - 8}`, stroke: "#6b7280", fill: "none" }));
      for (const value of [0, 0.5, 1]) {
        svg.append(svgNode("path", { d: `M${pad} ${y(value)}H${width - 8}`, stroke: "#e5e7eb", fill: "none" }));
        svg.append(svgNode("text", { x: pad - 5, y: y(value) + 4, "font-size": 10, "text-anchor": "end", fill: "#55606e" }, String(value)));
      }
      for (const [i, value] of [[0, -1], [(count - 1) / 2, 0], [count - 1, 1]])
        svg.append(svgNode("text", { x: x(i), y: height - 12, "font-size": 10, "text-anchor": "middle", fill: "#55606e" },
          (value * state.lobe.extent).toFixed(3).replace("-", "−")));
      for (const name of names) {
        const line = state.lobe.cuts[name][which].map((value, i) => `${i ? "L" : "M"}${x(i).toFixed(1)} ${y(value).toFixed(1)}`).join("");
        const style = { d: line, fill: "none", stroke: colour(name), "stroke-width": name === data.fit ? 2.4 : 1.6 };
        if (name === "reference") Object.assign(style, { d: `${line}L${x(count - 1)} ${y(0)}L${x(0)} ${y(0)}Z`, fill: "#d8dce2", "stroke-width": 1.2 });
        svg.append(svgNode("path", style));
      }
      return svg;
    }

    function draw() {
      const here = set.lobes.filter((lobe) => lobe.level === state.lobe.level);
      press(levelButtons, levelButtons[levels.indexOf(state.lobe.level)]);
      where.querySelectorAll("button").forEach((button) => button.remove());
      here.forEach((lobe, i) => {
        const button = make("button", { type: "button", textContent: i + 1, title: `texel ${lobe.column}, ${lobe.row}` });
        button.style.left = 100 * lobe.u + "%";
        button.style.top = 100 * lobe.v + "%";
        button.setAttribute("aria-pressed", String(lobe === state.lobe));
        button.addEventListener("click", () => { state.lobe = lobe; draw(); });
        where.append(button);
      });
      text.textContent = `Level ${state.lobe.level}, texel ${state.lobe.column}, ${state.lobe.row}; ` +
        `h from ${state.lobe.centre.map((value) => value.toFixed(3).replace("-", "−")).join(", ")} ± ${state.lobe.extent.toFixed(3)}.`;
      const names = ["reference", ...data.order.filter((name) => state.lobe.heat[name])];
      heats.replaceChildren(...names.map((name) => {
        const caption = name === "reference" ? "apparent lobe" : decibels(state.lobe.snr[name]) + " dB";
        const button = make("button", { type: "button" },
          make("img", { src: state.lobe.heat[name], alt: "" }), make("span", {}, make("b", { textContent: name }), " " + caption));
        button.style.setProperty("--swatch", colour(name));
        button.setAttribute("aria-pressed", String(name === "reference" || state.shown.has(name)));
        button.addEventListener("click", () => {
          if (name === "reference") return;
          if (!state.shown.delete(name)) state.shown.add(name);
          draw();
        });
        return button;
      }));
      cuts.replaceChildren(plot(0, "through the peak, along the long axis"), plot(1, "across"));
    }
    draw();
  }

  function maps(root, set) {
    for (const name of data.order)
      if (set.maps[name])
        root.append(make("div", { textContent: name }),
          make("img", { src: set.maps[name], alt: `roughness and anisotropy of every level by ${name}`, loading: "lazy" }));
  }

  document.querySelectorAll("section[data-set]").forEach((section) => {
    const set = data.sets[Number(section.dataset.set)];
    viewer(section.querySelector(".viewer"), set);
    lobes(section.querySelector(".lobe-viewer"), set);
    maps(section.querySelector(".maps"), set);
  });
  document.documentElement.dataset.ready = "yes";
})();
