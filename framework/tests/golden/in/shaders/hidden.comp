#version 460
// Once there was a buffer Past { uint p[]; } here.
layout(set = 0, binding = 0, std430) writeonly buffer Out { uint o[]; };
#if WIDTH > 8
layout(set = 0, binding = 1, std430) readonly buffer Wide { uint w[]; };
#endif
void main() {
    uint local = 1;
#if WIDTH > 8
    local += w[0];
#endif
    o[0] = local;
}
