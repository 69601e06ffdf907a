// Colours of one pixel of each level of a texture, as RGBA bytes: drawn to a target of one pixel and read back.
const VERTICES = `#version 300 es
void main(){vec2 p=vec2((gl_VertexID<<1)&2,gl_VertexID&2);gl_Position=vec4(p*2.-1.,0,1);}`;
const FRAGMENT = `#version 300 es
precision highp float;uniform highp sampler2D t;uniform float k;out vec4 c;void main(){c=textureLod(t,vec2(.5),k);}`;

export function levelsOf(gl, texture, count) {
  const program = gl.createProgram();
  for (const [type, text] of [[gl.VERTEX_SHADER, VERTICES], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
    const shader = gl.createShader(type);
    gl.shaderSource(shader, text); gl.compileShader(shader); gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  const frame = gl.createFramebuffer(), target = gl.createTexture(), found = [];
  gl.activeTexture(gl.TEXTURE0); gl.bindTexture(gl.TEXTURE_2D, target); gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA8, 1, 1);
  gl.bindFramebuffer(gl.FRAMEBUFFER, frame);
  gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, target, 0);
  gl.useProgram(program); gl.viewport(0, 0, 1, 1);
  for (const flag of [gl.DEPTH_TEST, gl.BLEND, gl.CULL_FACE, gl.SCISSOR_TEST, gl.STENCIL_TEST]) gl.disable(flag);
  gl.colorMask(true, true, true, true); gl.bindVertexArray(null); gl.bindSampler(0, null);
  gl.bindTexture(gl.TEXTURE_2D, texture);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST_MIPMAP_NEAREST);
  for (let level = 0; level < count; level++) {
    gl.uniform1f(gl.getUniformLocation(program, 'k'), level);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    const pixel = new Uint8Array(4);
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);
    found.push(Array.from(pixel));
  }
  return found;
}
