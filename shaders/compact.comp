#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_ballot : require

// Compacts the visible splats: pairs of depth key and index, in the order of their indices. A splat's place is the offset
// of its block, plus the number of visible splats before it in the block. There are no atomics, so the same scene gives
// the same order in every frame, and a stable sort keeps equal depths in the order of their indices.

#include "camera.glsl"
#include "depth_key.glsl"
#include "groups.glsl"
#include "thread_index.glsl"

layout(local_size_x = 256) in;

layout(set = 0, binding = 0, std430) readonly buffer Depth { float depth[]; };
layout(set = 0, binding = 1, std430) readonly buffer BlockOffset { uint block_offset[]; };
layout(set = 0, binding = 2, std430) writeonly buffer Keys { uint keys[]; };
layout(set = 0, binding = 3, std430) writeonly buffer Order { uint order[]; };

shared uint visible_in_subgroup[256 / DEVICE_SUBGROUP_SIZE];

void main() {
    uint group = group_index();
    uint i = group * gl_WorkGroupSize.x + thread_index();
    float z = i < uint(SCENE_COUNT) ? depth[i] : -1.0;
    bool is_visible = z > 0.0;

    uvec4 visible = subgroupBallot(is_visible);
    uint rank = subgroupBallotExclusiveBitCount(visible);
    if (gl_SubgroupInvocationID == 0u) {
        visible_in_subgroup[gl_SubgroupID] = subgroupBallotBitCount(visible);
    }
    barrier();
    if (is_visible) {
        uint place = block_offset[group] + rank;
        for (uint s = 0u; s < gl_SubgroupID; s++) {
            place += visible_in_subgroup[s];
        }
        keys[place] = depth_key(z);
        order[place] = i;
    }
}
