/* Light through the thin pair, ray by ray: rung "thin" in float32, as clacad/tracing/reference/thin.py has it.

Lengths are in pitches along x, and a ray is known by the cell it is in and by where it is from that cell's
middle, so that nothing far from the middle of the sheet is the difference of two large numbers. Directions have
z = 1. Whoever compiles this defines SAMPLES, and HEX, TILTED, FIELD, BAFFLE, OUTLINE, SEAM, BODY, DEBUG where there are hexagons,
tilted lenses, … : what a sheet does not have costs nothing. */
precision highp float;

uniform vec2 size;                        // pixels
uniform vec3 eye, ahead, right, up;       // sheet frame; right and up reach the border of the picture
uniform vec2 count, pitch, firstCentre;
uniform vec3 kept, solid;                 // outline of the cells, and of the bodies: 0 none, 1 round, 2 rectangle; half sizes
uniform vec2 solidCentre;                 // of array 2's body, from array 1's
uniform mat3 turn;                        // lens to sheet
uniform vec2 power1, power2;
uniform vec3 apex2;                       // lens 2's centre: x, y from its own cell's, z over lens 1's
uniform vec2 wholeSteps, residual;        // displacement of array 2's cells
uniform vec4 span;                        // low, high of array 1's patches; of array 2's
uniform float margin, opaque, baffle;     // half a seam; land stops light; half a wall
uniform vec2 fieldFocus, fieldPower;      // depth and power of the field lens along lens x and y
uniform vec4 fieldCentre;                 // middle of its cells at these depths
uniform float objectAt, card;             // depth behind lens 1 and size of what is looked at
uniform float ghosts;
uniform float part;                       // which pair of numbers DEBUG writes

const float ALIVE = 0.0, GHOST = 1.0, LAND = 2.0, BACKWARD = 3.0, VIGNETTED = 6.0, MISSED = 7.0; // clacad.Fate

#if defined(SEAM) || defined(BODY) || defined(TILTED)
#define LANDED
#endif

struct Ray { vec2 cell; vec2 local; float z; vec3 d; };
struct Met { bool lens; bool land; bool gap; };
struct Passed { vec2 first; vec2 last; vec2 at; float z; vec3 d; float fate; };

vec2 across(vec2 steps) {
#ifdef HEX
  return vec2(steps.x + 0.5 * steps.y, steps.y * pitch.y);
#else
  return steps * pitch;
#endif
}

void relocate(inout vec2 cell, inout vec2 local) {
#ifdef HEX
  vec2 k, from = local;
  k.y = floor(from.y / pitch.y + 0.5);
  k.x = floor(from.x - 0.5 * k.y + 0.5);
  local = from - across(k);
  for (int n = 0; n < 4; n++) {
    float b = 0.5 * local.x + pitch.y * local.y, c = b - local.x;
    vec2 s = local.x >= 0.5 ? vec2(1.0, 0.0) : local.x < -0.5 ? vec2(-1.0, 0.0)
      : b >= 0.5 ? vec2(0.0, 1.0) : b < -0.5 ? vec2(0.0, -1.0)
      : c >= 0.5 ? vec2(-1.0, 1.0) : c < -0.5 ? vec2(1.0, -1.0) : vec2(0.0);
    if (s == vec2(0.0)) break;
    k += s;
    local = from - across(k);
  }
  cell += k;
#else
  vec2 k = floor(local / pitch + 0.5);
  cell += k;
  local -= k * pitch;
#endif
}

vec2 middle(vec2 cell) { return firstCentre + across(cell); }

bool within(vec3 outline, vec2 p) {
  return outline.x < 1.5 ? length(p) <= outline.y : p.x <= outline.y && p.y <= outline.z;
}

bool contains(vec2 cell) {
#ifdef HEX
  float first = -floor(0.5 * cell.y);
#else
  float first = 0.0;
#endif
  if (cell.y < 0.0 || cell.y >= count.y || cell.x < first || cell.x >= first + count.x) return false;
#ifdef OUTLINE
  vec2 m = abs(middle(cell)); // the farthest corner is on the middle's own side
#ifdef HEX
  return within(kept, m + vec2(0.5, 0.28867513459481287)) && within(kept, m + vec2(0.0, 0.5773502691896258));
#else
  return within(kept, m + 0.5 * pitch);
#endif
#else
  return true;
#endif
}

#ifdef HEX
const int BORDERS = 3;
vec2 normalOf(int n) {
  return n == 0 ? vec2(1.0, 0.0) : n == 1 ? vec2(0.5, 0.8660254037844386) : vec2(-0.5, 0.8660254037844386);
}
vec2 stepOf(int n) { return n == 0 ? vec2(1.0, 0.0) : n == 1 ? vec2(0.0, 1.0) : vec2(-1.0, 1.0); }
float halfOf(int n) { return 0.5; }
#else
const int BORDERS = 2;
vec2 normalOf(int n) { return n == 0 ? vec2(1.0, 0.0) : vec2(0.0, 1.0); }
vec2 stepOf(int n) { return normalOf(n); }
float halfOf(int n) { return n == 0 ? 0.5 * pitch.x : 0.5 * pitch.y; }
#endif

bool inZone(vec2 local, float less) {
  bool inside = true;
  for (int n = 0; n < BORDERS; n++) inside = inside && abs(dot(normalOf(n), local)) <= halfOf(n) - less;
  return inside;
}

#ifdef TILTED
/* How far a point may go along d before it leaves its cell, and into which one it then comes. */
float nextBorder(vec2 local, vec2 d, out vec2 into) {
  float nearest = 1e30;
  into = vec2(0.0);
  for (int n = 0; n < BORDERS; n++) {
    float speed = dot(normalOf(n), d);
    if (speed == 0.0) continue;
    float way = speed < 0.0 ? -1.0 : 1.0;
    float t = (way * halfOf(n) - dot(normalOf(n), local)) / speed;
    if (t < nearest) { nearest = t; into = way * stepOf(n); }
  }
  return nearest;
}
#endif

/* Find the patch, or the gap between two, that a ray passes on its way up from its array's lowest point. */
Met meet(inout Ray r, vec2 apex, float high, vec2 centre, vec2 shift) {
#ifdef TILTED
  vec3 n = turn[2];
  float climb = dot(r.d, n), room = high - r.z, since = 0.0, at = max(room, 0.0);
  bool found = false, slipped = false;
  for (int k = 0; k < 24; k++) {
    vec2 into;
    float rise = -(dot(r.local - apex, n.xy) + r.z * n.z);
    float end = nextBorder(r.local, r.d.xy, into);
    if (contains(r.cell)) {
      slipped = since > 0.0 && since * climb >= rise; // already over this patch where the column begins
      found = slipped || (climb > 0.0 && rise <= end * climb);
      if (found) { at = slipped ? since : rise / climb; break; }
    }
    if (end >= room) break;
    r.cell += into;
    r.local -= across(into);
    since = max(end, since);
  }
  r.local += at * r.d.xy;
  r.z += at;
#else
  const bool slipped = false;
  bool found = contains(r.cell);
#endif
  Met m;
  m.lens = found && !slipped;
#ifdef SEAM
  m.lens = m.lens && inZone(r.local, margin);
#endif
  m.gap = slipped;
  m.land = !m.lens && found;
#ifdef BODY
  if (!found) m.land = within(solid, abs(middle(r.cell) + shift + r.local - centre));
#endif
  return m;
}

/* Behind a thin lens with its centre at `apex` of the cell frame. */
vec3 bend(Ray r, vec2 apex, vec2 power) {
  vec3 q = vec3(r.local - apex, r.z) * turn, d = r.d * turn; // transposed: sheet to lens
  return turn * vec3(d.xy - q.xy * power * d.z, d.z);
}

#ifdef FIELD
/* One cylinder of the field lens, along lens axis x or y (lenses that are not tilted). */
void fieldFace(inout Ray r, bool x) {
  float depth = (x ? fieldFocus.x : fieldFocus.y) - r.z;
  r.z += depth;
  r.local += depth * r.d.xy;
  vec2 cell = vec2(0.0), at = r.local - (x ? fieldCentre.xy : fieldCentre.zw);
  relocate(cell, at);
  vec2 axis = x ? turn[0].xy : turn[1].xy;
  r.d.xy -= axis * dot(axis, at) * (x ? fieldPower.x : fieldPower.y);
}
#endif

Passed straight(vec2 at, float z, vec3 d, float fate) {
  Passed p;
  p.first = p.last = vec2(-32768.0);
  p.at = at; p.z = z; p.d = d; p.fate = fate;
  return p;
}

Passed through(vec3 d) {
  if (d.z <= 0.0) return straight(eye.xy, eye.z, d, MISSED);
  d /= d.z;
  Ray r;
  r.d = d;
  r.z = span.x;
  vec2 met = eye.xy + (span.x - eye.z) * d.xy;
#ifdef HEX
  r.cell = vec2(0.0);
  r.local = met - firstCentre;
  relocate(r.cell, r.local);
#else
  vec2 q = met / pitch + 0.5 * count;
  r.cell = floor(q);
  r.local = (fract(q) - 0.5) * pitch;
#endif
  Met one = meet(r, vec2(0.0), span.y, vec2(0.0), vec2(0.0));
  if (!one.lens && !one.land) return straight(met, span.x, d, MISSED);
  Passed p = straight(middle(r.cell) + r.local, r.z, r.d, VIGNETTED);
  vec2 named = contains(r.cell) ? r.cell : vec2(-32768.0);
  p.first = named;
#ifdef LANDED
  if (one.land && !one.gap && opaque > 0.5) return p;
#endif
  p.fate = BACKWARD;
  vec3 out1 = one.lens ? bend(r, vec2(0.0), power1) : r.d;
#ifdef TILTED
  if (out1.z <= 0.0 || dot(r.d, turn[2]) <= 0.0) return p;
  r.d = out1 / out1.z;
#else
  r.d = out1; // z stays 1
#endif
#ifdef BAFFLE
  Ray left = r;
#endif
#ifdef FIELD
  bool xFirst = fieldFocus.x <= fieldFocus.y;
  fieldFace(r, xFirst);
  fieldFace(r, !xFirst);
#endif
  float gap = apex2.z + span.z - r.z;
  r.local += gap * r.d.xy - residual;
  r.cell -= wholeSteps;
  relocate(r.cell, r.local);
  r.z = span.z;
  vec2 shift = across(wholeSteps) + residual;
  Met two = meet(r, apex2.xy, span.w, solidCentre, shift);
  p.at = middle(r.cell) + shift + r.local;
  p.z = apex2.z + r.z;
  p.d = r.d;
  p.fate = MISSED;
#ifdef BAFFLE
  p.fate = VIGNETTED;
  if (r.cell != left.cell || !inZone(left.local, baffle) || !inZone(r.local, baffle)) return p;
  if (!two.lens && !two.land) return p;
  p.fate = MISSED;
#endif
  if (!two.lens && !two.land) return p;
  p.last = contains(r.cell) ? r.cell : vec2(-32768.0);
  p.fate = one.land || two.land ? LAND : named != p.last ? GHOST : ALIVE;
#ifdef LANDED
  if (two.land && !two.gap && opaque > 0.5) { p.fate = VIGNETTED; return p; }
#endif
  vec3 out2 = two.lens ? bend(r, apex2.xy, power2) : r.d;
#ifdef TILTED
  if (out2.z <= 0.0 || dot(r.d, turn[2]) <= 0.0) p.fate = BACKWARD;
  else p.d = out2 / out2.z;
#else
  p.d = out2;
#endif
  return p;
}

#ifdef DEBUG
vec2 halves(float whole) { // 0 to 65535 as two bytes
  float high = floor(whole / 256.0);
  return vec2(high, whole - 256.0 * high) / 255.0;
}
vec2 slope(float t) { return halves(floor((clamp(t, -1.0, 1.0) + 1.0) * 32767.5 + 0.5)); }
vec2 index(float k) { return halves(clamp(k + 32768.0, 0.0, 65535.0)); }
void main() {
  vec2 uv = 2.0 * gl_FragCoord.xy / size - 1.0;
  Passed p = through(ahead + uv.x * right + uv.y * up);
  gl_FragColor = part < 0.5 ? vec4(slope(p.d.x), index(p.last.x))
    : part < 1.5 ? vec4(slope(p.d.y), index(p.last.y))
    : part < 2.5 ? vec4(halves(p.fate), index(p.first.x)) : vec4(halves(p.fate), index(p.first.y));
}
#else
/* A card of four colours with an F on it, on a chequered wall: it shows what is turned over, and how large. */
vec3 wall(vec2 q) {
  vec2 a = abs(q), tile = fract(q * 3.0) - 0.5;
  float far = max(a.x, a.y), even = step(0.0, tile.x * tile.y);
  vec3 grey = mix(vec3(0.50, 0.55, 0.60), vec3(0.74, 0.78, 0.82), 1.0 - even);
  grey = mix(vec3(0.62, 0.66, 0.70), grey, 1.0 / (1.0 + 0.08 * far));
  vec2 s = step(0.0, q);
  vec3 c = mix(mix(vec3(0.93, 0.76, 0.30), vec3(0.36, 0.60, 0.80), s.y), mix(vec3(0.42, 0.70, 0.52), vec3(0.85, 0.45, 0.38), s.y), s.x);
  c = mix(c, vec3(1.0), 0.35 * even);
  vec2 f = vec2(-q.x, q.y); // x of the sheet is to the left of whoever looks towards +z
  vec3 box = vec3(0.11, 0.40, 0.31) - abs(f.xxx - vec3(-0.27, 0.02, -0.07)); // stem, top and bar
  vec3 high = vec3(0.62, 0.10, 0.10) - abs(f.yyy - vec3(0.0, 0.52, 0.08));
  vec3 ink = step(0.0, box) * step(0.0, high);
  c = mix(c, vec3(0.12, 0.15, 0.19), max(step(0.94, far), max(ink.x, max(ink.y, ink.z))));
  return mix(c, grey, step(1.0, far));
}

vec3 seen(vec3 d) {
  Passed p = through(d);
  if (p.d.z <= 0.0) return vec3(0.62, 0.66, 0.70);
  vec3 c = wall((p.at + (objectAt - p.z) / p.d.z * p.d.xy) / card);
  bool dark = p.fate == BACKWARD || p.fate == VIGNETTED || (p.fate == MISSED && p.first.x > -32768.0);
  if (p.fate == GHOST) c = mix(c, vec3(0.55, 0.10, 0.75), 0.55) * ghosts;
  return dark ? vec3(0.0) : c;
}

void main() {
  vec3 sum = vec3(0.0);
  float at = fract(52.9829189 * fract(dot(floor(gl_FragCoord.xy), vec2(0.06711056, 0.00583715)))); // Jimenez's noise
  for (int n = 0; n < SAMPLES; n++) {
    vec2 jitter = SAMPLES == 1 ? vec2(0.0) : fract(at + float(n) * vec2(0.7548776662, 0.5698402910)) - 0.5; // Roberts's R2
    vec2 uv = 2.0 * (gl_FragCoord.xy + jitter) / size - 1.0;
    sum += seen(ahead + uv.x * right + uv.y * up);
  }
  gl_FragColor = vec4(sum / float(SAMPLES), 1.0);
}
#endif
