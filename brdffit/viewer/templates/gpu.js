// Elements, the context, and WebGL's objects.

const started = performance.now();
const $ = id => document.getElementById(id);
const value = id => +$(id).value;
const query = new URLSearchParams(location.search), test = query.has("test");
// Tensors are stored multiplied: half floats lose precision at small alpha^2.
const TENSOR_SCALE = 1024;
const ROLES = [["normal", "RGBA16F"], ["tensor", "RGBA16F"], ["specular", "SRGB8_ALPHA8"], ["diffuse", "SRGB8_ALPHA8"]];

function tellFailure(text) {
  $("message").textContent = text;
  document.title = "error";
  $("result").textContent = JSON.stringify({error: text});
}

function fail(text) {
  tellFailure(text);
  throw Error(text);
}

const canvas = $("view");
const gl = canvas.getContext("webgl2", {antialias: false, alpha: false, preserveDrawingBuffer: true});
if (!gl) fail("This browser has no WebGL2.");
if (!gl.getExtension("EXT_color_buffer_float"))
  fail("This browser cannot draw into float textures (EXT_color_buffer_float).");
const anisotropy = gl.getExtension("EXT_texture_filter_anisotropic");

// A program; its `set` takes uniforms as {name: [suffix of gl.uniform..., values]}.
function makeProgram(fragment) {
  const program = gl.createProgram();
  for (const [type, id] of [[gl.VERTEX_SHADER, "screen"], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(type);
    gl.shaderSource(shader, $(id).textContent.trim().replaceAll("TENSOR_SCALE", TENSOR_SCALE.toFixed(1)));
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) fail(`${id}: ${gl.getShaderInfoLog(shader)}`);
    gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) fail(gl.getProgramInfoLog(program));
  const places = {};
  program.set = uniforms => {
    for (const [name, [kind, ...values]] of Object.entries(uniforms)) {
      places[name] ??= gl.getUniformLocation(program, name);
      if (places[name]) gl["uniform" + kind](places[name], ...values);
    }
  };
  return program;
}

// A texture with room for some levels, bound.
function makeTexture(internal, width, height, levels, filter, wrapS, wrapT) {
  const texture = gl.createTexture();
  gl.bindTexture(gl.TEXTURE_2D, texture);
  gl.texStorage2D(gl.TEXTURE_2D, levels, internal, width, height);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, levels > 1 ? gl.LINEAR_MIPMAP_LINEAR : filter);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, filter);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, wrapS);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_T, wrapT);
  return texture;
}

// Textures of a panel, one a role; with one level and `average`, the browser makes the others.
function uploadLevels(levels, wrap, average) {
  const {width, height} = levels[0], beyond = wrap === "tile" ? gl.REPEAT : gl.CLAMP_TO_EDGE;
  const count = average ? Math.floor(Math.log2(Math.max(width, height))) + 1 : levels.length;
  return ROLES.map(([role, internal]) => {
    const texture = makeTexture(gl[internal], width, height, count, gl.LINEAR, beyond, beyond);
    const type = internal === "RGBA16F" ? gl.FLOAT : gl.UNSIGNED_BYTE;
    levels.forEach((level, k) =>
      gl.texSubImage2D(gl.TEXTURE_2D, k, 0, 0, level.width, level.height, gl.RGBA, type, level[role]),
    );
    if (average) gl.generateMipmap(gl.TEXTURE_2D);
    return texture;
  });
}

function uploadEnvironment({width, height, pixels}) {
  const texture = makeTexture(gl.RGBA16F, width, height, 1, gl.LINEAR, gl.REPEAT, gl.CLAMP_TO_EDGE);
  gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, width, height, gl.RGBA, gl.FLOAT, pixels);
  return texture;
}

// A float picture that can be drawn into.
function makeTarget(width, height) {
  const texture = makeTexture(gl.RGBA32F, width, height, 1, gl.NEAREST, gl.CLAMP_TO_EDGE, gl.CLAMP_TO_EDGE);
  const frame = gl.createFramebuffer();
  gl.bindFramebuffer(gl.FRAMEBUFFER, frame);
  gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, texture, 0);
  if (gl.checkFramebufferStatus(gl.FRAMEBUFFER) !== gl.FRAMEBUFFER_COMPLETE) fail("no float framebuffer");
  return {texture, frame, width, height};
}

function bindTexture(unit, texture) {
  gl.activeTexture(gl.TEXTURE0 + unit);
  gl.bindTexture(gl.TEXTURE_2D, texture);
}
