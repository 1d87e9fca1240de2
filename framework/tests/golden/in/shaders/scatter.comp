#version 460
layout(local_size_x = 64) in;
layout(set = 0, binding = 0, std430) readonly buffer Keys { uint keys[]; };
layout(set = 0, binding = 1, std430) readonly buffer Values { uint values[]; };
layout(set = 0, binding = 2, std430) writeonly buffer OutKeys { uint out_keys[]; };
layout(set = 0, binding = 3, std430) writeonly buffer OutValues { uint out_values[]; };
void main() {
    uint i = gl_GlobalInvocationID.x;
    out_keys[63 - i] = keys[i];
    out_values[63 - i] = values[i];
}
