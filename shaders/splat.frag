#version 460
#extension GL_GOOGLE_include_directive : require

// Shades one splat at one pixel: the Gaussian's value times the opacity, premultiplied for blending.

#include "live.glsl"

layout(location = 0) flat in vec2 centre;
layout(location = 1) flat in vec4 inverse_axes;
layout(location = 2) flat in vec4 colour;

layout(location = 0) out vec4 blended;
#if WITH_OUTPUTS
layout(location = 3) flat in float depth;

// The depth, blended like the colours, but always in 32-bit floats.
layout(location = 1) out vec4 blended_depth;
#endif

void main() {
    // Distance from the centre in sigmas, along both axes. The power is minus a sum of squares, so it is never above 0.
    vec2 from_centre = gl_FragCoord.xy - 0.5 - centre;
    vec2 sigmas = vec2(dot(from_centre, inverse_axes.xy), dot(from_centre, inverse_axes.zw));
    float power = -0.5 * dot(sigmas, sigmas);
    float alpha = min(alpha_cap, colour.a * exp(power));
    if (alpha < alpha_floor) {
        discard;
    }
    blended = vec4(colour.rgb * alpha, alpha);
#if WITH_OUTPUTS
    blended_depth = vec4(depth * alpha, 0.0, 0.0, alpha);
#endif
}
