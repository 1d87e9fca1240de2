#version 460
layout(local_size_x = 64) in;
layout(set = 0, binding = 0, std430) buffer Needed { uint needed; };
layout(set = 0, binding = 1, std430) writeonly buffer List { uint list[]; };
void main() {
    uint pixel = gl_GlobalInvocationID.x;
    if (pixel >= min(WANTED, VIEWPORT_WIDTH * VIEWPORT_HEIGHT)) return;
    // Counts every entry, and writes it if the list has room.
    uint entry = atomicAdd(needed, 1u);
    if (entry < ENTRIES) list[entry] = pixel;
}
