/* Light through the thin pair, ray by ray: rung "thin" in float32, as clacad/tracing/reference/thin.py has it.

Lengths are in pitches along x, and a ray is known by the cell it is in and by where it is from that cell's
middle, so that nothing far from the middle of the sheet is the difference of two large numbers. Directions have
z = 1. The caller defines SAMPLES, and HEX, TILTED, FIELD, AIMED, BAFFLE, OUTLINE, SEAM, BODY, DEBUG where there are hexagons,
tilted lenses, rays directed away from the sheet (BEHIND), … : a feature that a sheet does not have costs nothing.

A condition is 0.0 or 1.0; both results are computed and mixed: without a graphics card,
branches and `bool`s cost twice what the optics does (tests/benchmarks/explorer.md). */
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
#ifdef AIMED
uniform float drift;                      // pitch of array 2's cells over array 1's, less 1
uniform vec2 fieldGrow;                   // pitch of the field lens's cells over array 1's
#else
const float drift = 0.0;
const vec2 fieldGrow = vec2(1.0);
#endif
uniform vec4 span;                        // low, high of array 1's patches; of array 2's
uniform float margin, opaque, baffle;     // half a seam; land stops light; half a wall
uniform vec3 stronger;                    // power of the lenses in red, green and blue, over the design's wavelength
uniform vec2 fieldFocus, fieldPower;      // depth and power of the field lens along lens x and y
uniform vec4 fieldCentre;                 // middle of its cells at these depths
uniform float objectAt, card;             // depth behind lens 1 and size of what is looked at
uniform float ghosts;
uniform float part;                       // which pair of numbers DEBUG writes

const float ALIVE = 0.0, GHOST = 1.0, LAND = 2.0, BACKWARD = 3.0, VIGNETTED = 6.0, MISSED = 7.0; // clacad.Fate
const float NOWHERE = -32768.0; // a cell that is none

#if defined(SEAM) || defined(BODY) || defined(TILTED)
#define LANDED
#endif

float strength = 1.0; // power of the lenses for the light that is traced

struct Ray { vec2 cell; vec2 local; float z; vec3 d; };
struct Met { float lens, land, gap, kept; };
struct Passed { vec2 first; vec2 last; vec2 at; float z; vec3 d; float fate; };

vec2 across(vec2 steps) {
#ifdef HEX
  return vec2(steps.x + 0.5 * steps.y, steps.y * pitch.y);
#else
  return steps * pitch;
#endif
}

/* Cells of a lattice with `grow` times the pitch. */
void relocate(inout vec2 cell, inout vec2 local, float grow) {
#ifdef AIMED
  local /= grow;
#endif
#ifdef HEX
  vec2 k, from = local;
  k.y = floor(from.y / pitch.y + 0.5);
  k.x = floor(from.x - 0.5 * k.y + 0.5);
  local = from - across(k);
  for (int n = 0; n < 2; n++) { // one step at most, and another for rounding
    float b = 0.5 * local.x + pitch.y * local.y;
    vec3 a = vec3(local.x, b, b - local.x), s = step(0.5, a) - (1.0 - step(-0.5, a)); // over which border
    s.y *= 1.0 - abs(s.x);
    s.z *= (1.0 - abs(s.x)) * (1.0 - abs(s.y));
    k += s.xy + s.z * vec2(-1.0, 1.0);
    local = from - across(k);
  }
  cell += k;
#else
  vec2 k = floor(local / pitch + 0.5);
  cell += k;
  local -= k * pitch;
#endif
#ifdef AIMED
  local *= grow;
#endif
}

vec2 middle(vec2 cell) { return firstCentre + across(cell); }

float both(vec2 so) { return so.x * so.y; }

float within(vec3 outline, vec2 p) {
  return outline.x < 1.5 ? step(length(p), outline.y) : both(step(p, outline.yz));
}

float contains(vec2 cell) {
#ifdef HEX
  vec2 k = cell + vec2(floor(0.5 * cell.y), 0.0);
#else
  vec2 k = cell;
#endif
  float found = both(step(0.0, k) * step(k, count - 1.0));
#ifdef OUTLINE
  vec2 m = abs(middle(cell)); // the farthest corner is on the middle's own side
#ifdef HEX
  found *= within(kept, m + vec2(0.5, 0.28867513459481287)) * within(kept, m + vec2(0.0, 0.5773502691896258));
#else
  found *= within(kept, m + 0.5 * pitch);
#endif
#endif
  return found;
}

#ifdef HEX
const int BORDERS = 3;
vec2 normalOf(int n) {
  return n == 0 ? vec2(1.0, 0.0) : n == 1 ? vec2(0.5, 0.8660254037844386) : vec2(-0.5, 0.8660254037844386);
}
vec2 stepOf(int n) { return n == 0 ? vec2(1.0, 0.0) : n == 1 ? vec2(0.0, 1.0) : vec2(-1.0, 1.0); }
#endif

float inZone(vec2 local, float less) {
#ifdef HEX
  float inside = 1.0;
  for (int n = 0; n < BORDERS; n++) inside *= step(abs(dot(normalOf(n), local)), 0.5 - less);
  return inside;
#else
  return both(step(abs(local), 0.5 * pitch - less));
#endif
}

#ifdef TILTED
/* How far a point may go along d before it leaves its cell, and into which one it then comes. */
float nextBorder(vec2 local, vec2 d, out vec2 into) {
#ifdef HEX
  float nearest = 1e30;
  into = vec2(0.0);
  for (int n = 0; n < BORDERS; n++) {
    float speed = dot(normalOf(n), d), way = 2.0 * step(0.0, speed) - 1.0;
    float t = (0.5 - way * dot(normalOf(n), local)) / max(way * speed, 1e-20);
    into = mix(into, way * stepOf(n), step(t, nearest));
    nearest = min(t, nearest);
  }
  return nearest;
#else
  vec2 way = 2.0 * step(0.0, d) - 1.0, t = (0.5 * pitch - way * local) / max(way * d, 1e-20);
  into = way * (t.x <= t.y ? vec2(1.0, 0.0) : vec2(0.0, 1.0));
  return min(t.x, t.y);
#endif
}
#endif

/* Find the patch, or the gap between two, that a ray passes on its way up from its array's lowest point. */
Met meet(inout Ray r, vec2 apex, float high, vec2 centre, vec2 shift, float drift) {
  Met m;
  float grow = 1.0 + drift;
  m.gap = 0.0;
#ifdef TILTED
  vec3 n = turn[2];
  float climb = dot(r.d, n), room = high - r.z, since = 0.0, at = max(room, 0.0), found = 0.0;
  for (int k = 0; k < 24; k++) {
    vec2 into;
    float rise = -(dot(r.local - apex + drift * middle(r.cell), n.xy) + r.z * n.z);
    float end = nextBorder(r.local / grow, r.d.xy / grow, into);
    if (contains(r.cell) > 0.5) {
      bool slipped = since > 0.0 && since * climb >= rise; // already over this patch where the column begins
      if (slipped || (climb > 0.0 && rise <= end * climb)) {
        found = 1.0;
        m.gap = slipped ? 1.0 : 0.0;
        at = slipped ? since : rise / climb;
        break;
      }
    }
    if (end >= room) break;
    r.cell += into;
    r.local -= across(into) * grow;
    since = max(end, since);
  }
  r.local += at * r.d.xy;
  r.z += at;
  m.kept = contains(r.cell);
#else
  float found = contains(r.cell);
  m.kept = found;
#endif
  m.lens = found * (1.0 - m.gap);
#ifdef SEAM
  m.lens *= inZone(r.local / grow, margin / grow);
#endif
  m.land = found * (1.0 - m.lens);
#ifdef BODY
  m.land = mix(within(solid, abs(middle(r.cell) * grow + shift + r.local - centre)), m.land, found);
#endif
  return m;
}

/* Behind a thin lens with its centre at `apex` of the cell frame. */
vec3 bend(Ray r, vec2 apex, vec2 power) {
#ifdef TILTED
  vec3 q = vec3(r.local - apex, r.z);
  vec2 less = vec2(dot(q, turn[0]), dot(q, turn[1])) * power * dot(r.d, turn[2]);
  return r.d - turn[0] * less.x - turn[1] * less.y;
#else
  vec2 q = r.local - apex, x = turn[0].xy, y = turn[1].xy;
  return vec3(r.d.xy - x * (power.x * dot(q, x)) - y * (power.y * dot(q, y)), r.d.z);
#endif
}

#ifdef FIELD
/* One cylinder of the field lens, along lens axis x or y (lenses that are not tilted). */
void fieldFace(inout Ray r, bool x) {
  float depth = (x ? fieldFocus.x : fieldFocus.y) - r.z, grow = x ? fieldGrow.x : fieldGrow.y;
  r.z += depth;
  r.local += depth * r.d.xy;
  vec2 cell = vec2(0.0), at = r.local - (x ? fieldCentre.xy : fieldCentre.zw);
#ifdef AIMED
  at -= (grow - 1.0) * middle(r.cell);
#endif
  relocate(cell, at, grow);
  vec2 axis = x ? turn[0].xy : turn[1].xy;
  float power = (x ? fieldPower.x : fieldPower.y) * contains(r.cell + cell) * strength; // none outside the sheet
  r.d.xy -= axis * dot(axis, at) * power;
}
#endif

Passed straight(vec2 at, float z, vec3 d, float fate) {
  Passed p;
  p.first = p.last = vec2(NOWHERE);
  p.at = at; p.z = z; p.d = d; p.fate = fate;
  return p;
}

Passed through(vec3 d) {
#ifdef BEHIND
  if (d.z <= 0.0) return straight(eye.xy, eye.z, d, MISSED);
#endif
  d /= d.z;
  Ray r;
  r.d = d;
  r.z = span.x;
  vec2 met = eye.xy + (span.x - eye.z) * d.xy;
#ifdef HEX
  r.cell = vec2(0.0);
  r.local = met - firstCentre;
  relocate(r.cell, r.local, 1.0);
#else
  vec2 q = met / pitch + 0.5 * count;
  r.cell = floor(q);
  r.local = (q - r.cell - 0.5) * pitch;
#endif
  Met one = meet(r, vec2(0.0), span.y, vec2(0.0), vec2(0.0), 0.0);
  float entered = max(one.lens, one.land), stopped = 0.0;
  vec2 named = mix(vec2(NOWHERE), r.cell, one.kept);
  Ray left = r;
  vec3 out1 = mix(r.d, bend(r, vec2(0.0), power1 * strength), one.lens);
#ifdef LANDED
  stopped = one.land * (1.0 - one.gap) * opaque;
#endif
#ifdef TILTED
  if (out1.z <= 0.0 || dot(r.d, turn[2]) <= 0.0) { // it ends here
    Passed p = straight(mix(met, middle(left.cell) + left.local, entered), mix(span.x, left.z, entered), d,
      entered < 0.5 ? MISSED : stopped < 0.5 ? BACKWARD : VIGNETTED);
    p.first = mix(vec2(NOWHERE), named, entered);
    return p;
  }
  r.d = out1 / out1.z;
#else
  r.d = out1; // z stays 1
#endif
#ifdef FIELD
  bool xFirst = fieldFocus.x <= fieldFocus.y;
  fieldFace(r, xFirst);
  fieldFace(r, !xFirst);
#endif
  float gap = apex2.z + span.z - r.z;
  r.local += gap * r.d.xy - residual;
#ifdef AIMED
  r.local -= drift * middle(r.cell);
#endif
  r.cell -= wholeSteps;
  relocate(r.cell, r.local, 1.0 + drift);
  r.z = span.z;
  vec2 shift = across(wholeSteps) * (1.0 + drift) + residual;
  Met two = meet(r, apex2.xy, span.w, solidCentre, shift, drift);
  float met2 = max(two.lens, two.land), goes = entered * (1.0 - stopped); // as far as array 2's plane
#ifdef BAFFLE
  vec2 aside = step(0.5, abs(r.cell - left.cell));
  float clear = (1.0 - max(aside.x, aside.y)) * inZone(left.local, baffle) * inZone(r.local / (1.0 + drift), baffle / (1.0 + drift)) * met2;
  float none = VIGNETTED; // walls, and nothing next to them
#else
  float clear = met2, none = MISSED;
#endif
  vec2 last = mix(vec2(NOWHERE), r.cell, two.kept), apart = step(0.5, abs(named - last));
  float ghost = mix(ALIVE, GHOST, max(apart.x, apart.y)), fate = mix(ghost, LAND, max(one.land, two.land)), left2 = 1.0;
#ifdef LANDED
  float dark = two.land * (1.0 - two.gap) * opaque;
  fate = mix(fate, VIGNETTED, dark);
  left2 -= dark;
#endif
  vec3 out2 = bend(r, apex2.xy - drift * middle(r.cell), power2 * strength);
#ifdef TILTED
  out2 = mix(r.d, out2, two.lens);
  float falls = max(step(out2.z, 0.0), step(dot(r.d, turn[2]), 0.0)) * left2;
  fate = mix(fate, BACKWARD, falls);
  left2 *= 1.0 - falls;
  out2 /= mix(1.0, out2.z, left2);
  left2 *= two.lens;
#else
  left2 *= two.lens;
#endif
  Passed p;
  float whole = goes * clear;
  p.first = mix(vec2(NOWHERE), named, entered);
  p.last = mix(vec2(NOWHERE), last, whole);
  p.fate = mix(mix(MISSED, mix(VIGNETTED, mix(none, fate, clear), goes), entered), fate, whole);
  p.at = mix(mix(met, middle(left.cell) + left.local, entered), middle(r.cell) * (1.0 + drift) + shift + r.local, goes);
  p.z = mix(mix(span.x, left.z, entered), apex2.z + r.z, goes);
  p.d = mix(mix(d, r.d, goes), out2, whole * left2);
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
#ifdef COLOUR
  strength = stronger.b; // of blue light
#endif
  Passed p = through(ahead + uv.x * right + uv.y * up);
  gl_FragColor = part < 0.5 ? vec4(slope(p.d.x), index(p.last.x))
    : part < 1.5 ? vec4(slope(p.d.y), index(p.last.y))
    : part < 2.5 ? vec4(halves(p.fate), index(p.first.x)) : vec4(halves(p.fate), index(p.first.y));
}
#else
#ifdef PHOTO
uniform sampler2D photo;
uniform vec2 photoHalf; // half sides over the card's
#endif
/* A card of four colours with an F on it, on a chequered wall: it shows what is turned over, and how large. */
vec3 wall(vec2 q) {
  vec2 a = abs(q), tile = fract(q * 3.0) - 0.5;
  float far = max(a.x, a.y), even = step(0.0, tile.x * tile.y);
  vec3 grey = mix(vec3(0.50, 0.55, 0.60), vec3(0.74, 0.78, 0.82), 1.0 - even);
  grey = mix(vec3(0.62, 0.66, 0.70), grey, 1.0 / (1.0 + 0.08 * far));
#ifdef PHOTO
  vec2 at = vec2(-q.x, q.y) / photoHalf; // x of the sheet is to the left of a viewer who looks towards +z
  vec3 shown = texture2D(photo, 0.5 + 0.5 * at).rgb;
  return mix(shown, grey, step(1.0, max(abs(at.x), abs(at.y))));
#else
  vec2 s = step(0.0, q);
  vec3 c = mix(mix(vec3(0.93, 0.76, 0.30), vec3(0.36, 0.60, 0.80), s.y), mix(vec3(0.42, 0.70, 0.52), vec3(0.85, 0.45, 0.38), s.y), s.x);
  c = mix(c, vec3(1.0), 0.35 * even);
  vec2 f = vec2(-q.x, q.y); // x of the sheet is to the left of a viewer who looks towards +z
  vec3 box = vec3(0.11, 0.40, 0.31) - abs(f.xxx - vec3(-0.27, 0.02, -0.07)); // stem, top and bar
  vec3 high = vec3(0.62, 0.10, 0.10) - abs(f.yyy - vec3(0.0, 0.52, 0.08));
  vec3 ink = step(0.0, box) * step(0.0, high);
  c = mix(c, vec3(0.12, 0.15, 0.19), max(step(0.94, far), max(ink.x, max(ink.y, ink.z))));
  return mix(c, grey, step(1.0, far));
#endif
}

vec3 seen(vec3 d) {
  Passed p = through(d);
#if defined(BEHIND) || defined(TILTED)
  if (p.d.z <= 0.0) return vec3(0.62, 0.66, 0.70);
#endif
  vec3 c = wall((p.at + (objectAt - p.z) / p.d.z * p.d.xy) / card);
  float ghost = step(abs(p.fate - GHOST), 0.5), stopped = step(BACKWARD, p.fate); // of them MISSED is dark behind array 1 only
  c = mix(c, mix(c, vec3(0.55, 0.10, 0.75), 0.55) * ghosts, ghost);
  return c * (1.0 - stopped * (1.0 - step(MISSED, p.fate) * step(p.first.x, NOWHERE)));
}

void main() {
  vec3 sum = vec3(0.0);
  float at = fract(52.9829189 * fract(dot(floor(gl_FragCoord.xy), vec2(0.06711056, 0.00583715)))); // Jimenez's noise
  for (int n = 0; n < SAMPLES; n++) {
    vec2 jitter = SAMPLES == 1 ? vec2(0.0) : fract(at + float(n) * vec2(0.7548776662, 0.5698402910)) - 0.5; // Roberts's R2
    vec2 uv = 2.0 * (gl_FragCoord.xy + jitter) / size - 1.0;
    vec3 d = ahead + uv.x * right + uv.y * up;
#ifdef COLOUR
    vec3 c;
    strength = stronger.r;
    c.r = seen(d).r;
    strength = stronger.g;
    c.g = seen(d).g;
    strength = stronger.b;
    c.b = seen(d).b;
    sum += c;
#else
    sum += seen(d);
#endif
  }
  gl_FragColor = vec4(sum / float(SAMPLES), 1.0);
}
#endif
