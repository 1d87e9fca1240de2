#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#extension GL_KHR_shader_subgroup_shuffle : require
#extension GL_EXT_control_flow_attributes : require

// Continues the tiles that serial_rasterise.comp has left with light: up to DEEP_ENTRIES more entries of their lists. A workgroup
// takes one block of a tile. All splats of a chunk are blended in one iteration of the loop, so that lavapipe's limit of 65,535
// iterations is out of reach.

#include "../camera.glsl"
#include "serial.glsl"
#include "live.glsl"
#include "record.glsl"
#include "serial_blend.glsl"
#include "../mesh/behind.glsl"

layout(push_constant) uniform Turn { uint turn; };

layout(set = 0, binding = 0, std430) readonly buffer Ranges { uvec2 ranges[]; };
layout(set = 0, binding = 1, std430) readonly buffer Lists { uint lists[]; };
layout(set = 0, binding = 2, std430) readonly buffer Records { StoredRecord records[]; };
layout(set = 0, binding = 3, std430) readonly buffer Deep { uint deep[]; };
layout(set = 0, binding = 4, rgba32f) uniform image2D picture;

void main() {
    uint slot = gl_WorkGroupID.z * 65535u + gl_WorkGroupID.y;
    if (slot >= deep[3]) {
        return;
    }
    uint lane = gl_SubgroupInvocationID;
    uint tile_index = deep[4u + slot];
    uvec2 tile = uvec2(tile_index % TILES_X, tile_index / TILES_X);
    uint block = gl_WorkGroupID.x;
    vec2 corner = vec2(tile * TILE);
    uint bin = bin_of_tile(tile);
    uint list_end = min(ranges[bin].y, uint(ENTRIES));
    uint list = min(ranges[bin].x, uint(ENTRIES)) + uint(SERIAL_SEGMENT);
    uint skipped = turn * uint(DEEP_ENTRIES);
    if (list >= list_end || list_end - list <= skipped) {
        return;
    }
    uint begin = list + skipped;
    uint end = begin + min(list_end - begin, uint(DEEP_ENTRIES));
    Limits limits = limits();

    vec4 sums[VECTORS];
#if WITH_OUTPUTS
    Pixel pixels_of[VECTORS];
#endif
    [[unroll]] for (uint v = 0u; v < VECTORS; v++) {
        uvec2 at = tile * TILE + pixel_in_tile(block, v, lane);
        uvec2 last = uvec2(VIEWPORT_WIDTH, VIEWPORT_HEIGHT) - 1u;
        // Pixels outside the picture or the block are finished.
        sums[v] = vec4(0.0, 0.0, 0.0, -1.0);
#if WITH_OUTPUTS
        pixels_of[v] = empty_pixel();
#endif
        if (lane < BLOCK_PIXELS && all(lessThanEqual(at, last))) {
            sums[v] = imageLoad(picture, ivec2(at));
#if WITH_OUTPUTS
            pixels_of[v] = pixels[at.y * uint(VIEWPORT_WIDTH) + at.x];
#endif
        }
    }
    bool open = true;
    for (uint first = begin; first < end && open; first += uint(LOADERS)) {
        uint at = min(first + lane, end - 1u);
        uint index = lists[at];
        Record r = COPY_NEAR(unpack_record(records[index]), corner.x + 0.5 * float(TILE));
        bool touches = first + lane < end && ((blocks_of(r, corner, alpha_floor) >> block) & 1u) != 0u;
        Splat own = seen_from(corner, r, limits AND(index));
        own.log_alpha = touches ? own.log_alpha : -1e6;
        [[unroll]] for (uint s = 0u; s < uint(LOADERS); s++) {
            blend_block(sums, splat_of_lane(own, s), vec2(pixel_in_tile(block, 0u, lane)), limits AND(pixels_of));
        }
        open = any_lane(has_light(sums, limits) ? 1u : 0u) != 0u;
    }

    bool is_whole = end == list_end;
    vec3 background = camera.background.rgb;
    [[unroll]] for (uint v = 0u; v < VECTORS; v++) {
        uvec2 at = tile * TILE + pixel_in_tile(block, v, lane);
        vec4 sum = sums[v];
        vec4 whole = vec4(sum.rgb + abs(sum.a) * BEHIND(at, background), 1.0);
        if (lane < BLOCK_PIXELS && at.x < uint(VIEWPORT_WIDTH) && at.y < uint(VIEWPORT_HEIGHT)) {
            imageStore(picture, ivec2(at), is_whole ? whole : sum);
#if WITH_OUTPUTS
            pixels_of[v].light = abs(sum.a);
            pixels[at.y * uint(VIEWPORT_WIDTH) + at.x] = pixels_of[v];
#endif
        }
    }
}
