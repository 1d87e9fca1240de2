#version 460
#extension GL_GOOGLE_include_directive : require

// One step of du/dt = D_u lap(u) - u v^2 + feed (1 - u), dv/dt = D_v lap(v) + u v^2 - (feed + kill) v, with dt = 1.

layout(local_size_x = 64) in;

#include "cells.glsl"
#include "live.glsl"

layout(set = 0, binding = 0, std430) readonly buffer Old { vec2 old_cells[]; };
layout(set = 0, binding = 1, std430) writeonly buffer New { vec2 new_cells[]; };

const vec2 DIFFUSION = vec2(0.2097, 0.105);

vec2 at(uint x, uint y) {
    return old_cells[y % SIDE * SIDE + x % SIDE];
}

void main() {
    uint i = cell_index();
    if (i >= SIDE * SIDE) return;
    uint x = i % SIDE, y = i / SIDE;
    vec2 cell = old_cells[i];
    // The side is added because unsigned numbers cannot go below zero.
    vec2 neighbours = at(x + 1u, y) + at(x + SIDE - 1u, y) + at(x, y + 1u) + at(x, y + SIDE - 1u);
    float reaction = cell.x * cell.y * cell.y;
    vec2 change = DIFFUSION * (neighbours - 4.0 * cell);
    change += vec2(-reaction + feed * (1.0 - cell.x), reaction - (feed + kill) * cell.y);
    new_cells[i] = cell + change;
}
