// The backend's own shaders: fills, clears, and the draw that shows a picture in a window.

#include <metal_stdlib>
using namespace metal;

// Writes fill.y to the first fill.x words.
kernel void fill_words(
    device uint *target [[buffer(0)]],
    constant uint2 &fill [[buffer(1)]],
    uint thread_index [[thread_position_in_grid]],
    uint threads [[threads_per_grid]]
) {
    for (uint word = thread_index; word < fill.x; word += threads) {
        target[word] = fill.y;
    }
}

kernel void clear_floats(
    texture2d<float, access::write> target [[texture(0)]],
    uint2 pixel [[thread_position_in_grid]]
) {
    if (pixel.x < target.get_width() && pixel.y < target.get_height()) {
        target.write(float4(0.0f), pixel);
    }
}

kernel void clear_words(
    texture2d<uint, access::write> target [[texture(0)]],
    uint2 pixel [[thread_position_in_grid]]
) {
    if (pixel.x < target.get_width() && pixel.y < target.get_height()) {
        target.write(uint4(0), pixel);
    }
}

struct Corner {
    float4 position [[position]];
    // Texture coordinates; row 0 of the picture is at the top.
    float2 at;
};

// One triangle that covers the window.
vertex Corner show_corner(uint corner [[vertex_id]]) {
    float2 at = float2(float((corner << 1) & 2u), float(corner & 2u));
    Corner result;
    result.position = float4(at.x * 2.0f - 1.0f, 1.0f - at.y * 2.0f, 0.0f, 1.0f);
    result.at = at;
    return result;
}

fragment float4 show_pixel(
    Corner corner [[stage_in]],
    texture2d<float> picture [[texture(0)]],
    sampler pixels [[sampler(0)]]
) {
    return float4(picture.sample(pixels, corner.at).rgb, 1.0f);
}
