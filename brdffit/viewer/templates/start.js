// Data to panels, then frames for as long as the page is open.

async function makePanels() {
  data = JSON.parse($("data").textContent);
  $("data").textContent = "";
  gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
  paint = makeProgram("paint");
  display = makeProgram("display");
  sky = data.environment ? uploadEnvironment(await unpackEnvironment(data.environment)) : gl.createTexture();
  const source = await unpackLevels(data.source);
  panels = [{name: "averaged", textures: uploadLevels(source, data.wrap, true)}];
  for (const {name, levels} of data.methods) {
    const made = await unpackLevels(levels), whole = made[0].height === source[0].height;
    panels.push({name, textures: uploadLevels(whole ? made : [source[0], ...made], data.wrap, false)});
  }
  // The reference reads level 0 alone, which the averaged panel has as well.
  panels.push({name: "reference", textures: panels[0].textures, reference: true});
}

function namePanels() {
  $("names").style.gridTemplateColumns = `repeat(${panels.length},1fr)`;
  panels.forEach((panel, k) => {
    const cell = document.createElement("div"), name = document.createElement("b");
    name.textContent = panel.name;
    cell.append(name, document.createElement("span"));
    $("names").append(cell);
    for (const id of ["left", "right"]) $(id).append(new Option(panel.name, k));
  });
  $("left").value = 1;
  $("right").value = panels.length - 1;
  $("note").textContent = data.note;
}

// The page's address sets controls: ?distance=0.5&light=1.
function obeyQuery() {
  for (const [id, asked] of query) {
    const control = $(id);
    if (!control || !/^(INPUT|SELECT)$/.test(control.tagName)) continue;
    if (control.type === "checkbox") control.checked = asked === "1";
    else control.value = asked;
  }
  for (const name of ["yaw", "pitch"]) if (query.has(name)) state[name] = +query.get(name);
}

// For tests (?test=1&frames=N): some frames, then figures as JSON in the element `result`.
function measure(loaded) {
  const before = performance.now(), frames = +(query.get("frames") || 16);
  for (let i = 0; i < frames; i++) draw();
  gl.finish();
  tellFigures();
  $("result").textContent = JSON.stringify({
    loaded,
    frame_ms: (performance.now() - before) / frames,
    error: gl.getError(),
    renderer: gl.getParameter(gl.RENDERER),
    names: panels.map(panel => panel.name),
    ...figures(),
  });
  document.title = "done";
}

// The first frame is to come soon: one sample a pixel, and it is not counted. Reading a pixel waits until it is drawn;
// `finish` does not everywhere.
function drawFirst() {
  const samples = state.samples;
  state.samples = 1;
  draw();
  gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
  performance.mark("first frame");
  state.samples = samples;
  again();
}

function loop() {
  const moving = $("move").checked;
  resize();
  if (moving) again();
  if (state.frame < MOST_FRAMES) {
    draw();
    if (state.frame % 16 === 0 && !moving && !wiping()) tellFigures();
  }
  requestAnimationFrame(loop);
}

async function start() {
  await makePanels();
  namePanels();
  performance.mark("loaded");
  const loaded = performance.now() - started;
  obeyQuery();
  label();
  resize();
  if (test) return measure(loaded);
  listen();
  drawFirst();
  loop();
}

start().catch(error => tellFailure(error.message));
