// What the graphics card does with a surface.
export const VERTEX = `#version 300 es
uniform mat4 seen; in vec3 ray; in float far; in vec2 lies; out vec3 place; out vec2 at;
void main() {
  place = far * ray;
  at = lies;
  gl_Position = seen * vec4(place, 1.0);
}`;
// Relief by a lamp that the viewer holds. From outside, what the endoscope sees at more than 85° is
// left open: it joins the two sides of a fold.
export const FRAGMENT = `#version 300 es
precision highp float;
uniform sampler2D picture; uniform vec3 eye; uniform vec4 ink; uniform float least;
in vec3 place; in vec2 at; out vec4 colour;
void main() {
  colour = ink;
  if (ink.a > 0.0) return;
  vec3 normal = normalize(cross(dFdx(place), dFdy(place)));
  if (abs(dot(normal, normalize(place))) < least) discard;
  float lit = 0.45 + 0.55 * abs(dot(normal, normalize(eye - place)));
  colour = vec4(pow(texture(picture, at).rgb, vec3(0.7)) * lit, 1.0);
}`;
