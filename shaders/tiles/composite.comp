#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require

// Composites the segments of a phase, near to far, behind those of earlier phases. The last phase adds the background and writes
// the picture; the others note the cells that still let light through. A workgroup takes half of a bin, as the rasteriser's
// invocations do: 32 cells, eight invocations each.

#include "../camera.glsl"
#include "../groups.glsl"
#include "live.glsl"
#include "record.glsl"
#include "bins.glsl"
#include "segments.glsl"

const uint THREADS = 256u;
layout(local_size_x = 256) in;

layout(set = 0, binding = 0, std430) readonly buffer Segments { uint segment_starts[]; };
layout(set = 0, binding = 1, std430) readonly buffer Partials { StoredSum partials[]; };
#define IS_LAST (PHASE + 1 == PHASES)
#if PHASE > 0 || !IS_LAST
layout(set = 0, binding = 2, std430) buffer Sums { vec4 sums[]; };
#endif
#if IS_LAST
layout(set = 0, binding = 3, rgba32f) writeonly uniform image2D picture;
#else
layout(set = 0, binding = 4, std430) writeonly buffer Open { uint open_cells[]; };
#endif

const uint PIXELS = uint(CELL) * uint(CELL) / 8u;

shared uint open;

void main() {
    const uint ROW = uint(BIN_COUNT) + 1u;
    uint group = group_index();
    uint bin = group / 2u;
    if (bin >= uint(BIN_COUNT)) {
        return;
    }
    uint thread = gl_LocalInvocationIndex;
    if (thread == 0u) {
        open = 0u;
    }
    barrier();
    uint first = segment_starts[uint(PHASE) * ROW + bin];
    uint end = segment_starts[uint(PHASE) * ROW + bin + 1u];
    uint cell = 32u * (group & 1u) + thread / 8u;
    uint eighth = thread & 7u;
    uvec2 pixel = uvec2(bin % uint(BINS_X), bin / uint(BINS_X)) * BIN + uint(CELL) * uvec2(cell % 8u, cell / 8u)
        + uvec2(eighth % uint(CELL), eighth / uint(CELL));

    [[unroll]] for (uint p = 0u; p < PIXELS; p++) {
        uint place = ((group & 1u) * PIXELS + p) * THREADS + thread;
#if PHASE > 0
        vec4 sum = sums[bin * BIN_PIXELS + place];
#else
        vec4 sum = vec4(0.0, 0.0, 0.0, 1.0);
#endif
        for (uint segment = first; segment < end && sum.a >= stop; segment++) {
            vec4 part = unpack_sum(partials[segment * BIN_PIXELS + place]);
            sum = vec4(sum.rgb + sum.a * part.rgb, sum.a * part.a);
        }
#if IS_LAST
        uvec2 at = pixel + uvec2(0u, p * (8u / uint(CELL)));
        if (at.x < uint(VIEWPORT_WIDTH) && at.y < uint(VIEWPORT_HEIGHT)) {
            imageStore(picture, ivec2(at), vec4(sum.rgb + abs(sum.a) * camera.background.rgb, 1.0));
        }
#else
        sums[bin * BIN_PIXELS + place] = sum;
        if (sum.a >= stop) {
            atomicOr(open, 1u << (thread / 8u));
        }
#endif
    }
#if !IS_LAST
    barrier();
    if (thread == 0u) {
        open_cells[group] = open;
    }
#endif
}
