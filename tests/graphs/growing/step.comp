#version 460
layout(local_size_x = 1) in;
layout(set = 0, binding = 0, std430) buffer Count { uint count; };
layout(set = 0, binding = 1, r32f) uniform image2D trail;
layout(set = 0, binding = 2, std430) writeonly buffer Needed { uint needed; };
layout(set = 0, binding = 3, std430) writeonly buffer List { uint list[]; };
void main() {
    count += 1u;
    imageStore(trail, ivec2(0), imageLoad(trail, ivec2(0)) + 1.0);
    needed = 2u * count;
    for (uint entry = 0; entry < min(needed, ROOM); ++entry) list[entry] = entry;
}
