#version 460
layout(local_size_x = 64) in;
layout(set = 0, binding = 0, rgba8) writeonly uniform image2D image;
void main() {
    uint pixel = gl_GlobalInvocationID.x;
    if (pixel >= VIEWPORT_WIDTH * VIEWPORT_HEIGHT) return;
    imageStore(image, ivec2(pixel % VIEWPORT_WIDTH, pixel / VIEWPORT_WIDTH), vec4(0.0, 0.0, 0.0, 1.0));
}
