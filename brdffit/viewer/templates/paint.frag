#version 300 es
precision highp float;
precision highp sampler2D;
uniform sampler2D uNormal, uTensor, uSpecular, uDiffuse, uSky, uBefore;
uniform vec2 uPanel, uOrigin;  // size and lower left corner of the panel in pixels
uniform mat3 uCamera;
uniform vec3 uEye, uMainLamp;
uniform float uTan, uRepeat, uTurn, uLampSize;
uniform int uScene, uLight, uFrame, uLevel, uSamples;
uniform bool uReference, uSkyFile;
out vec4 color;
const float PI = 3.14159265;

uint seed;
float random() {  // PCG
  seed = seed * 747796405u + 2891336453u;
  uint w = ((seed >> ((seed >> 28u) + 4u)) ^ seed) * 277803737u;
  w = (w >> 22u) ^ w;
  return float(w >> 8) / 16777216.;
}

{% include "lobe.glsl" %}

vec3 turned(vec3 d, float by) {
  float c = cos(by), s = sin(by);
  return vec3(c * d.x - s * d.y, s * d.x + c * d.y, d.z);
}

vec3 sky(vec3 d) {
  d = turned(d, -uTurn);
  if (uSkyFile) return textureLod(uSky, vec2(.5 - atan(d.y, d.x) / (2. * PI), acos(clamp(d.z, -1., 1.)) / PI), 0.).rgb;
  // Two soft boxes over a gradient.
  vec3 gradient = mix(vec3(.10, .09, .08), vec3(.35, .45, .6), smoothstep(-.2, 1., d.z));
  vec3 warm = vec3(6, 5.4, 4.6) * smoothstep(.86, .9, dot(d, normalize(vec3(-.6, .5, .62))));
  vec3 cold = vec3(1.6, 2.2, 3.2) * smoothstep(.93, .96, dot(d, normalize(vec3(.75, .2, .5))));
  return gradient + warm + cold;
}

Texel fetch(vec2 uv, vec2 dx, vec2 dy) {
  vec4 normal, tensor, specular, diffuse;
  if (uReference || uLevel >= 0) {
    float level = uReference ? 0. : float(uLevel);
    normal = textureLod(uNormal, uv, level);
    tensor = textureLod(uTensor, uv, level);
    specular = textureLod(uSpecular, uv, level);
    diffuse = textureLod(uDiffuse, uv, level);
  } else {
    normal = textureGrad(uNormal, uv, dx, dy);
    tensor = textureGrad(uTensor, uv, dx, dy);
    specular = textureGrad(uSpecular, uv, dx, dy);
    diffuse = textureGrad(uDiffuse, uv, dx, dy);
  }
  return Texel(normalize(normal.xyz), tensor.xyz / TENSOR_SCALE, specular.rgb * specular.a * 4., diffuse.rgb);
}

// A direction to lamp i; of a lamp that has a size, to a random point of its disc.
vec3 lamp(int i) {
  vec3 l = i == 0 ? uMainLamp : i == 1 ? normalize(vec3(-.7, .2, .5)) : normalize(vec3(.1, -.6, .75));
  l = turned(l, uTurn);
  if (uLampSize == 0.) return l;
  float r = uLampSize * sqrt(random()), angle = 2. * PI * random();
  vec3 across = normalize(cross(abs(l.z) < .9 ? vec3(0, 0, 1) : vec3(1, 0, 0), l));
  return normalize(l + r * (cos(angle) * across + sin(angle) * cross(l, across)));
}

// Nearest hit of the ray o + t D before t, which is then set.
bool hitBall(vec3 o, vec3 D, vec3 centre, float radius, inout float t) {
  vec3 p = o - centre;
  float b = dot(p, D), a = dot(D, D), q = b * b - a * (dot(p, p) - radius * radius);
  if (q < 0.) return false;
  float s = (-b - sqrt(q)) / a;
  if (s <= 0. || s >= t) return false;
  t = s;
  return true;
}
bool hitTube(vec3 o, vec3 D, float radius, float top, inout float t) {
  float a = dot(D.xy, D.xy), b = dot(o.xy, D.xy), q = b * b - a * (dot(o.xy, o.xy) - radius * radius);
  if (q < 0. || a < 1e-9) return false;
  float s = (-b - sqrt(q)) / a, z = o.z + s * D.z;
  if (s <= 0. || s >= t || z > top || z < -1.) return false;
  t = s;
  return true;
}

// Where a ray meets the surface: position, normal, texture coordinates, and the position's derivatives by them.
struct Hit {
  vec3 P, N, Pu, Pv;
  vec2 uv;
};

Hit onPlane(vec3 P) {
  return Hit(P, vec3(0, 0, 1), vec3(2. / uRepeat, 0, 0), vec3(0, 2. / uRepeat, 0), P.xy * .5 * uRepeat);
}
Hit onTube(vec3 P, float radius) {
  vec2 uv = vec2(atan(P.y, P.x) / PI * radius, P.z * .32) * uRepeat * 2.;
  return Hit(P, vec3(P.xy / radius, 0), vec3(-P.y, P.x, 0) * PI / (radius * 2. * uRepeat), vec3(0, 0, 1. / (.64 * uRepeat)), uv);
}
Hit onBall(vec3 P, vec3 centre, float radius) {
  vec3 c = P - centre, N = c / radius;
  float r = max(length(c.xy), 1e-3 * radius);
  vec2 uv = vec2(atan(c.y, c.x) / PI, 1. - acos(clamp(N.z, -1., 1.)) / PI) * uRepeat * radius;
  return Hit(P, N, vec3(-c.y, c.x, 0) * PI / (uRepeat * radius), vec3(-c.xy * c.z / r, r) * PI / (uRepeat * radius), uv);
}

bool hitScene(vec3 D, out float t, out Hit hit) {
  t = 1e9;
  if (uScene == 1) {
    if (D.z >= -1e-4) return false;
    t = -uEye.z / D.z;
    hit = onPlane(uEye + t * D);
    return true;
  }
  // A ball, or a knob: a smaller ball on a tube.
  bool knob = uScene == 2;
  vec3 centre = vec3(0, 0, knob ? .35 : 0.);
  float radius = knob ? .65 : 1.;
  bool ball = hitBall(uEye, D, centre, radius, t);
  bool tube = knob && hitTube(uEye, D, .38, .1, t);
  if (!ball && !tube) return false;
  if (tube) hit = onTube(uEye + t * D, .38);
  else hit = onBall(uEye + t * D, centre, radius);
  return true;
}

vec3 underLamps(Texel x, vec3 v, mat3 T) {
  vec3 sum = vec3(0);
  for (int i = 0; i < 3; i++) {
    vec3 l = lamp(i);
    if (dot(l, T[2]) > 0.) sum += brdf(l * T, v, x) * (i == 0 ? 3. : 1.5);
  }
  return sum;
}

// A normal of the lobe as seen from V (Heitz 2018); the tensor's Cholesky factor stands for its two alphas.
vec3 visibleNormal(vec3 V, vec3 S) {
  float l11 = sqrt(max(S.x, 1e-12)), l21 = S.z / l11, l22 = sqrt(max(S.y - l21 * l21, 1e-12));
  vec3 w = normalize(vec3(l11 * V.x + l21 * V.y, l22 * V.y, V.z));
  float r = sqrt(random()), angle = 2. * PI * random();
  vec3 t1 = w.z < .9999 ? normalize(cross(vec3(0, 0, 1), w)) : vec3(1, 0, 0), t2 = cross(w, t1);
  float a = r * cos(angle), b = mix(sqrt(max(1. - a * a, 0.)), r * sin(angle), .5 * (1. + w.z));
  vec3 m = a * t1 + b * t2 + sqrt(max(0., 1. - a * a - b * b)) * w;
  return normalize(vec3(l11 * m.x, l21 * m.x + l22 * m.y, max(m.z, 0.)));
}

// One direction of the visible lobe, one of the cosine.
vec3 underSky(Texel x, vec3 v, mat3 T) {
  vec3 V = intoFrame(v, x.normal), sum = vec3(0);
  float edge = grazing(x.specular);
  vec3 h = visibleNormal(V, x.S), L = reflect(-V, h), l = outOfFrame(L, x.normal);
  if (L.z > 0. && l.z > 0.) {
    // A viewer below the horizon counts as one on it, but its visible area shrinks.
    float ofV = stretch(V, x.S), area = V.z + sqrt(V.z * V.z + ofV), nv = max(V.z, 0.);
    float longL = sqrt(L.z * L.z + stretch(L, x.S)), longV = sqrt(nv * nv + ofV);
    float unmasked = L.z * area / (L.z * longV + nv * longL), fresnel = schlick(dot(V, h)) * edge;
    sum += (x.specular * (1. - fresnel) + fresnel) * unmasked * sky(T * l);
  }
  float z = sqrt(random()), angle = 2. * PI * random();
  l = outOfFrame(vec3(sqrt(1. - z * z) * vec2(cos(angle), sin(angle)), z), x.normal);
  vec3 below = x.diffuse * max(1. - x.specular, 0.) * (1. - schlick(z) * edge) * (1. - schlick(V.z) * edge);
  if (l.z > 0.) sum += below * sky(T * l);
  return sum;
}

vec3 radiance(vec2 pixel) {
  vec3 D = uCamera * vec3((pixel / uPanel * 2. - 1.) * vec2(uPanel.x / uPanel.y, 1.) * uTan, 1.);
  float t;
  Hit at;
  if (!hitScene(D, t, at)) return uLight == 1 ? sky(normalize(D)) : vec3(.02);
  // Exact ray differentials: how far the hit moves from one pixel to the next.
  vec3 Dx = uCamera * vec3(2. * uTan / uPanel.y, 0, 0), Dy = uCamera * vec3(0, 2. * uTan / uPanel.y, 0);
  vec3 toX = t * Dx - D * dot(t * Dx, at.N) / dot(D, at.N), toY = t * Dy - D * dot(t * Dy, at.N) / dot(D, at.N);
  vec3 u = at.Pu / dot(at.Pu, at.Pu), v = at.Pv / dot(at.Pv, at.Pv);
  // Row 0 of the picture is at the top.
  const vec2 down = vec2(1, -1);
  Texel x = fetch(at.uv * down, vec2(dot(toX, u), dot(toX, v)) * down, vec2(dot(toY, u), dot(toY, v)) * down);
  mat3 T = mat3(normalize(at.Pu), normalize(at.Pv), at.N);
  vec3 towardsEye = normalize(-D) * T;
  return uLight == 0 ? underLamps(x, towardsEye, T) : underSky(x, towardsEye, T);
}

void main() {
  vec2 pixel = gl_FragCoord.xy - uOrigin;
  seed = uint(pixel.x) * 1973u + uint(pixel.y) * 9277u + uint(uFrame) * 26699u + 1u;
  random();
  // The reference is sampled all over the pixel, the others at its centre.
  int count = uReference ? uSamples : uLight == 1 ? 2 : 1;
  vec3 sum = vec3(0);
  for (int i = 0; i < count; i++) sum += radiance(pixel + (uReference ? vec2(random(), random()) - .5 : vec2(0)));
  vec4 before = uFrame == 0 ? vec4(0) : texelFetch(uBefore, ivec2(gl_FragCoord.xy), 0);
  color = vec4(mix(before.rgb, sum / float(count), 1. / float(uFrame + 1)), 1);
}
