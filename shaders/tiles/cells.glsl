// Finds the cells of a bin that a splat touches.

// Returns the cells within a distance that rounding cannot bridge: bit column of row r is bit 8 (r mod 4) + column of word
// r / 4. `corner` is the bin's first pixel.
//
// The ellipse at the alpha floor is cut by each row of cells; its leftmost and rightmost points within a row are those of the
// ellipse if they are in the row, and on the nearer edge of the row otherwise.
uvec2 cells_of(Record r, vec2 corner) {
    const float MARGIN = 1.0 / 64.0;
    const float SIDE = float(CELL);
    float limit = max(r.log_alpha - log2(alpha_floor), 0.0);
    vec2 centre = r.centre - corner;
    float reach = sqrt(limit);
    float half_height = reach / r.root.z + MARGIN;
    float lean = -r.root.y / r.root.x;
    // The height of the rightmost point below the centre (y points down); the leftmost is as far above.
    float peak = -r.root.y * reach * inversesqrt(r.root.z * r.root.z + r.root.y * r.root.y) / r.root.z;
    vec2 low = vec2(0.0, max(centre.y - half_height, 0.0));
    vec2 high = vec2(float(BIN) - 1.0, min(centre.y + half_height, float(BIN) - 1.0));
#if EXTENT == EXTENT_TILES
    vec2 columns = tile_range(r.centre.x, r.radius) - corner.x;
    vec2 rows = tile_range(r.centre.y, r.radius) - corner.y;
    low = max(low, vec2(columns.x, rows.x));
    high = min(high, vec2(columns.y, rows.y));
#endif
    uvec2 cells = uvec2(0u);
    if (!(low.y <= high.y)) {
        return cells;
    }
    uint last_row = min(uint(high.y / SIDE), 7u);
    for (uint row = uint(low.y / SIDE); row <= last_row; row++) {
        float first = max(float(row) * SIDE, low.y) - centre.y;
        float last = min(float(row) * SIDE + (SIDE - 1.0), high.y) - centre.y;
        vec2 at = clamp(vec2(-peak, peak), first - MARGIN, last + MARGIN);
        vec2 v = r.root.z * at;
        vec2 half_width = sqrt(max(limit - v * v, 0.0)) / r.root.x + MARGIN;
        float left = max(centre.x + lean * at.x - half_width.x, low.x);
        float right = min(centre.x + lean * at.y + half_width.y, high.x);
        if (first <= last + MARGIN && left <= right) {
            uint from = uint(max(ceil((left - (SIDE - 1.0)) / SIDE), 0.0));
            uint to = uint(right / SIDE);
            uint bits = from <= to ? (2u << to) - (1u << from) : 0u;
            if (row < 4u) {
                cells.x |= bits << (8u * row);
            } else {
                cells.y |= bits << (8u * (row - 4u));
            }
        }
    }
    return cells;
}
