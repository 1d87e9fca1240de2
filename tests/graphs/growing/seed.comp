#version 460
layout(local_size_x = 1) in;
layout(set = 0, binding = 0, std430) writeonly buffer Count { uint count; };
layout(set = 0, binding = 1, r32f) writeonly uniform image2D trail;
void main() {
    count = 5u;
    imageStore(trail, ivec2(0), vec4(5));
}
