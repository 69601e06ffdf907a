// The panels beside each other: drawn into floats, the mean of all frames, then displayed.

const PLANE = 1, WIPE = 2, DIFFERENCE = 1, MOST_FRAMES = 256;
const state = {yaw: 0.6, pitch: 0.5, frame: 0, samples: 8, pointers: new Map()};
let data, sky, paint, display;
let panels = [], targets = [];

const wiping = () => value("show") === WIPE;

function again() {
  state.frame = 0;
}

// Pictures of the size of the window, made anew when it changes.
function resize() {
  const count = panels.length, ratio = test ? 1 : Math.min(devicePixelRatio, 2);
  const full = (query.get("width") || canvas.clientWidth || 900) * ratio;
  // The wipe shows one panel in the full width; all are still drawn beside each other.
  const width = Math.max(64, Math.min(Math.floor(wiping() ? full / 2 : full / count), 1024));
  const height = Math.min(width, Math.floor((innerHeight || 900) * ratio * 0.8));
  const shown = wiping() ? width : width * count;
  const [old] = targets;
  if (old && old.width === width * count && old.height === height && canvas.width === shown) return;
  canvas.width = shown;
  canvas.height = height;
  canvas.style.width = wiping() ? width / ratio + "px" : "100%";
  for (const {texture, frame} of targets) {
    gl.deleteTexture(texture);
    gl.deleteFramebuffer(frame);
  }
  targets = [makeTarget(width * count, height), makeTarget(width * count, height)];
  again();
}

// Position, axes (right, up, forward) and tangent of half the field of view.
function camera() {
  const plane = value("scene") === PLANE, near = plane ? 0.6 : 3, far = plane ? 40 : 3;
  const distance = near * Math.pow(far / near, value("distance"));
  const [cy, sy, cp, sp] = [Math.cos(state.yaw), Math.sin(state.yaw), Math.cos(state.pitch), Math.sin(state.pitch)];
  const eye = [distance * cy * cp, distance * sy * cp, distance * sp];
  const forward = eye.map(x => -x / distance), right = [-sy, cy, 0];
  const [[a, b, c], [x, y, z]] = [right, forward];
  const up = [b * z - c * y, c * x - a * z, a * y - b * x];
  return {eye, axes: [...right, ...up, ...forward], tangent: plane ? 0.45 : 1.1 / Math.sqrt(distance * distance - 1)};
}

function paintPanels(to, from) {
  const width = to.width / panels.length, {eye, axes, tangent} = camera();
  // The far ball keeps its size on the screen: its texture is repeated.
  const repeat = value("scene") === PLANE ? 1 : 2 ** Math.round(6 * value("distance"));
  if (state.frame === 0) state.time = $("move").checked ? performance.now() / 1000 : 1;
  gl.bindFramebuffer(gl.FRAMEBUFFER, to.frame);
  gl.useProgram(paint);
  bindTexture(4, sky);
  bindTexture(5, from.texture);
  paint.set({
    uNormal: ["1i", 0], uTensor: ["1i", 1], uSpecular: ["1i", 2], uDiffuse: ["1i", 3], uSky: ["1i", 4],
    uBefore: ["1i", 5], uPanel: ["2f", width, to.height], uEye: ["3f", ...eye],
    uCamera: ["Matrix3fv", false, axes], uTan: ["1f", tangent],
    uMainLamp: ["3f", Math.cos(state.time) * 0.7, Math.sin(state.time) * 0.7, 0.714],
    uTurn: ["1f", (value("turn") * Math.PI) / 180], uLampSize: ["1f", Math.tan((value("size") * Math.PI) / 180)],
    uRepeat: ["1f", data.repeat * repeat], uScene: ["1i", value("scene")], uLight: ["1i", value("light")],
    uFrame: ["1i", state.frame], uLevel: ["1i", value("level")], uSamples: ["1i", state.samples],
    uSkyFile: ["1i", data.environment ? 1 : 0],
  });
  panels.forEach((panel, k) => {
    gl.viewport(k * width, 0, width, to.height);
    paint.set({uOrigin: ["2f", k * width, 0], uReference: ["1i", panel.reference ? 1 : 0]});
    panel.textures.forEach((texture, unit) => {
      bindTexture(unit, texture);
      if (anisotropy)
        gl.texParameterf(gl.TEXTURE_2D, anisotropy.TEXTURE_MAX_ANISOTROPY_EXT, $("aniso").checked ? 16 : 1);
    });
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  });
}

function displayPanels(from) {
  const last = panels.length - 1;
  gl.bindFramebuffer(gl.FRAMEBUFFER, null);
  gl.viewport(0, 0, canvas.width, from.height);
  gl.useProgram(display);
  bindTexture(0, from.texture);
  display.set({
    uMean: ["1i", 0], uExposure: ["1f", 2 ** value("exposure")], uShow: ["1i", value("show")],
    uWidth: ["1i", from.width / panels.length], uReference: ["1i", last], uLeft: ["1i", value("left")],
    uRight: ["1i", value("right")], uWipe: ["1f", value("wipe")],
  });
  gl.drawArrays(gl.TRIANGLES, 0, 3);
  const line = $("wipeLine");
  line.style.display = wiping() ? "block" : "none";
  line.style.left = value("wipe") * canvas.clientWidth + "px";
}

function draw() {
  const to = targets[state.frame % 2], from = targets[(state.frame + 1) % 2];
  paintPanels(to, from);
  state.frame++;
  state.shown = to;
  displayPanels(to);
}
