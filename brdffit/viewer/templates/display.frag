#version 300 es
precision highp float;
uniform highp sampler2D uMean;
uniform float uExposure, uWipe;
uniform int uShow, uWidth, uReference, uLeft, uRight;
out vec4 color;

// Exposure, a soft shoulder, sRGB; figures.js has it too.
vec3 display(ivec2 p) {
  vec3 c = texelFetch(uMean, p, 0).rgb * uExposure;
  c = c / (1. + c * .25);
  return mix(c * 12.92, 1.055 * pow(max(c, 1e-5), vec3(1. / 2.4)) - .055, step(.0031308, c));
}

void main() {
  ivec2 p = ivec2(gl_FragCoord.xy);
  int panel = p.x / uWidth, x = p.x - panel * uWidth;
  if (uShow == 2) {
    int from = float(x) < uWipe * float(uWidth) ? uLeft : uRight;
    color = vec4(display(ivec2(from * uWidth + x, p.y)), 1);
    return;
  }
  vec3 c = display(p);
  if (uShow == 1 && panel != uReference) {
    vec3 d = c - display(ivec2(uReference * uWidth + x, p.y));
    float m = dot(d, vec3(.2126, .7152, .0722)) * 2.;
    // Orange: too bright; blue: too dark.
    c = mix(vec3(.12), m > 0. ? vec3(1., .45, .1) : vec3(.2, .55, 1.), min(abs(m), 1.));
  }
  color = vec4(c, 1);
}
