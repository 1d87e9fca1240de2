#version 460
layout(local_size_x = 1) in;
layout(set = 0, binding = 0, std430) readonly buffer Count { uint count; };
layout(set = 0, binding = 1, r32f) readonly uniform image2D trail;
layout(set = 0, binding = 2, rgba8) writeonly uniform image2D image;
void main() {
    float steps = imageLoad(trail, ivec2(0)).r;
    imageStore(image, ivec2(gl_WorkGroupID.xy), vec4(steps, float(count), 0, 255) / 255.0);
}
