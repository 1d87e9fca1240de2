// Finds the cells of a bin that a splat touches.

#include "cut.glsl"

const float SIDE = float(CELL);

// Returns the columns of the cells of `row` that the splat touches, a bit each.
uint columns_of(Cut c, uint row) {
    vec2 span = span_of(c, float(row) * SIDE, float(row) * SIDE + (SIDE - 1.0));
    if (!(span.x <= span.y)) {
        return 0u;
    }
    uint from = uint(max(ceil((span.x - (SIDE - 1.0)) / SIDE), 0.0));
    uint to = uint(span.y / SIDE);
    return from <= to ? (2u << to) - (1u << from) : 0u;
}
