// Intersects the ellipse of a splat at the alpha floor with rows of pixels. If the ellipse's leftmost
// point is outside the rows, the leftmost point within them is on their nearer edge; likewise the rightmost point.

// A splat relative to a rectangle of the picture: positions in pixels from the rectangle's first pixel.
struct Cut {
    vec2 centre;
    float limit;        // of the squared distance in sigmas, scaled like the root
    float lean;         // x of the middle of the ellipse per y
    float peak;         // from the centre down to the rightmost point; the leftmost is as far above
    float inverse_x;    // pixels per scaled sigma in a row
    float root_y;       // scaled sigmas per pixel from row to row
    vec2 low, high;     // the pixels that may be touched
};

// Margin beyond the ellipse, in pixels, so that rounding drops no pixel.
const float CUT_MARGIN = 1.0 / 64.0;

// The minimum of `limit`: LEAST_LOG of projection.glsl, in powers of 2.
const float LEAST_LIMIT = 1.4427e-6;

// Returns the ellipse relative to the rectangle of `size` pixels at `corner`, for a splat that ends at the alpha `least`.
Cut cut_of(Record r, vec2 corner, vec2 size, float least) {
    Cut c;
    c.limit = max(r.log_alpha - log2(least), LEAST_LIMIT);
    c.centre = r.centre - corner;
    c.inverse_x = 1.0 / r.root.x;
    c.root_y = r.root.z;
    c.lean = -r.root.y * c.inverse_x;
    float reach = sqrt(c.limit);
    float half_height = reach / r.root.z;
    // The length of a vector whose squares may overflow or underflow.
    float longer = max(r.root.z, abs(r.root.y));
    float slant = longer * length(r.root.zy / longer);
    c.peak = -(r.root.y / slant) * half_height;
    vec2 half_size = vec2((slant / r.root.z) * reach * c.inverse_x, half_height) + CUT_MARGIN;
    c.low = max(c.centre - half_size, vec2(0.0));
    c.high = min(c.centre + half_size, size - 1.0);
#if EXTENT == EXTENT_TILES
    vec2 columns = tile_range(r.centre.x, r.radius) - corner.x;
    vec2 rows = tile_range(r.centre.y, r.radius) - corner.y;
    c.low = max(c.low, vec2(columns.x, rows.x));
    c.high = min(c.high, vec2(columns.y, rows.y));
#endif
    return c;
}

// Returns the first and the last pixel that the splat may touch in the rows `top` to `bottom`; the first is beyond the last if there
// is none.
vec2 span_of(Cut c, float top, float bottom) {
    float first = max(top, c.low.y) - c.centre.y;
    float last = min(bottom, c.high.y) - c.centre.y;
    vec2 at = clamp(vec2(-c.peak, c.peak), first - CUT_MARGIN, last + CUT_MARGIN);
    vec2 v = c.root_y * at;
    vec2 half_width = sqrt(max(c.limit - v * v, 0.0)) * c.inverse_x + CUT_MARGIN;
    float left = max(c.centre.x + c.lean * at.x - half_width.x, c.low.x);
    float right = min(c.centre.x + c.lean * at.y + half_width.y, c.high.x);
    return first <= last ? vec2(left, right) : vec2(1.0, 0.0);
}
