// Finds the cells of a bin that a splat touches.

#include "cut.glsl"

// Returns the columns of the cells of `row` that the splat touches, as a bit mask.
uint columns_of(Cut c, uint row) {
    const float side = float(CELL);
    vec2 span = span_of(c, float(row) * side, float(row) * side + (side - 1.0));
    if (!(span.x <= span.y)) {
        return 0u;
    }
    uint from = uint(max(ceil((span.x - (side - 1.0)) / side), 0.0));
    uint to = uint(span.y / side);
    return from <= to ? (2u << to) - (1u << from) : 0u;
}
