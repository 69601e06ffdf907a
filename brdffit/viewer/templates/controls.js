// Mouse, touch and keys.

function changeDistance(by) {
  $("distance").value = value("distance") + by;
  again();
}

function turn(right, up) {
  state.yaw -= right;
  state.pitch = Math.max(0.02, Math.min(1.5, state.pitch + up));
  again();
}

function choose(id, chosen) {
  $(id).value = chosen;
  again();
  label();
}

// What depends on the controls around the canvas.
function label() {
  $("levelText").textContent = value("level") < 0 ? "auto" : value("level");
  $("sizeText").textContent = value("size") ? `${value("size")}°` : "point";
  document.querySelectorAll(".wipe").forEach(each => (each.style.display = wiping() ? "" : "none"));
  $("names").style.display = wiping() ? "none" : "grid";
}

function listenToPointers() {
  const spread = () => {
    const [a, b] = [...state.pointers.values()];
    return Math.hypot(a[0] - b[0], a[1] - b[1]);
  };
  canvas.onpointerdown = event => {
    canvas.setPointerCapture(event.pointerId);
    canvas.focus({preventScroll: true});
    state.pointers.set(event.pointerId, [event.clientX, event.clientY]);
  };
  canvas.onpointermove = event => {
    const last = state.pointers.get(event.pointerId);
    if (!last) return;
    const before = state.pointers.size === 2 ? spread() : 0;
    state.pointers.set(event.pointerId, [event.clientX, event.clientY]);
    if (state.pointers.size === 2) changeDistance(-0.002 * (spread() - before));
    else turn((event.clientX - last[0]) * 0.008, (event.clientY - last[1]) * 0.008);
  };
  canvas.onpointerup = canvas.onpointercancel = event => state.pointers.delete(event.pointerId);
  const wheel = event => {
    event.preventDefault();
    changeDistance(event.deltaY * 0.0005);
  };
  canvas.addEventListener("wheel", wheel, {passive: false});
}

const KEYS = {
  ArrowLeft: () => turn(-0.05, 0),
  ArrowRight: () => turn(0.05, 0),
  ArrowUp: () => turn(0, 0.05),
  ArrowDown: () => turn(0, -0.05),
  "+": () => changeDistance(-0.02),
  "=": () => changeDistance(-0.02),
  "-": () => changeDistance(0.02),
  "[": () => choose("level", value("level") - 1),
  "]": () => choose("level", value("level") + 1),
  d: () => choose("show", value("show") === DIFFERENCE ? 0 : DIFFERENCE),
  w: () => choose("show", wiping() ? 0 : WIPE),
  " ": () => {
    $("move").checked = !$("move").checked;
    again();
  },
};

function listen() {
  for (const id of ["scene", "light", "show", "left", "right", "distance", "level", "size", "turn", "aniso", "move"])
    $(id).oninput = () => {
      again();
      label();
    };
  // These change the display alone; a picture that is done takes one frame more to show it.
  for (const id of ["exposure", "wipe"]) $(id).oninput = () => (state.frame = Math.min(state.frame, MOST_FRAMES - 1));
  listenToPointers();
  canvas.onkeydown = event => {
    const action = KEYS[event.key];
    if (!action || event.ctrlKey || event.metaKey) return;
    event.preventDefault();
    action();
  };
  addEventListener("resize", again);
}
