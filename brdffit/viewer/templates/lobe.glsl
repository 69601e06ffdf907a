// The BRDF times n.l as brdffit/models/microfacet.py has it, for GGX. S is Sigma as (XX, YY, XY) in alpha^2.
struct Texel {
  vec3 normal, S, specular, diffuse;
};

// A vector in the frame of n: the one that the shortest rotation of z to n carries; and back.
vec3 intoFrame(vec3 w, vec3 n) {
  float k = dot(w.xy, n.xy) / max(1. + n.z, 1e-6) + w.z;
  return vec3(w.xy - k * n.xy, dot(w, n));
}
vec3 outOfFrame(vec3 w, vec3 n) {
  float k = dot(w.xy, n.xy) / max(1. + n.z, 1e-6) - w.z;
  return vec3(w.xy - k * n.xy, n.z * w.z - dot(n.xy, w.xy));
}

// d Sigma d: what roughness adds to the squared length of a direction in the masking term.
float stretch(vec3 d, vec3 S) {
  return max(d.x * (S.x * d.x + 2. * S.z * d.y) + S.y * d.y * d.y, 0.);
}

float distribution(vec3 h, vec3 S) {
  if (h.z <= 0.) return 0.;
  float det = max(S.x * S.y - S.z * S.z, max(1e-12 * S.x * S.y, 1e-30));
  float q = max((h.x * (S.y * h.x - 2. * S.z * h.y) + S.x * h.y * h.y) / det, 0.) + h.z * h.z;
  return 1. / (PI * sqrt(det) * q * q);
}

float schlick(float c) {
  float m = clamp(1. - c, 0., 1.);
  return m * m * m * m * m;
}

// Below a specular colour of 0.02 the light at grazing angles fades too.
float grazing(vec3 specular) {
  return min(max(max(specular.r, specular.g), specular.b) / .02, 1.);
}

vec3 brdf(vec3 l, vec3 v, Texel t) {
  vec3 L = intoFrame(l, t.normal), V = intoFrame(v, t.normal);
  if (L.z <= 0.) return vec3(0);
  vec3 H = normalize(L + V);
  float nl = max(L.z, 1e-4), nv = max(V.z, 1e-4);
  float visible = .5 / (nl * sqrt(nv * nv + stretch(V, t.S)) + nv * sqrt(nl * nl + stretch(L, t.S)));
  float edge = grazing(t.specular), fresnel = schlick(dot(V, H)) * edge;
  vec3 below = t.diffuse * max(1. - t.specular, 0.) * (1. - schlick(L.z) * edge) * (1. - schlick(V.z) * edge);
  return distribution(H, t.S) * visible * L.z * (t.specular * (1. - fresnel) + fresnel) + below * L.z / PI;
}
