#version 460
#extension GL_GOOGLE_include_directive : require

// Shades a mesh: one light, ambient and emission, by the metallic-roughness model of glTF 2.0 (appendix B). Outputs the display-encoded
// colour and the view depth, or the distance where splats are ordered by it.

#include "../camera.glsl"
#include "texture.glsl"

struct Material {
    vec4 base;
    float metallic, roughness, normal_scale, alpha_cutoff;
    uvec2 base_image, rough_image, normal_image, glow_image;  // see texture.glsl
    vec4 glow;  // w is 1 for an unlit material
};

layout(set = 0, binding = 5, std430) readonly buffer Materials { Material materials[]; };
// The direction to the light in the world; its colour, and the share of ambient light.
layout(set = 0, binding = 7, std430) readonly buffer Light { vec4 light[]; };

layout(location = 0) in vec3 from_camera;
layout(location = 1) in vec3 normal;
layout(location = 2) in vec2 uv;
layout(location = 3) in float depth;
layout(location = 4) flat in vec3 along_u;
layout(location = 5) flat in vec3 along_v;
layout(location = 6) flat in uint material;

layout(location = 0) out vec4 surface;

const float PI = 3.14159265358979;
// Minimum roughness: the highlights of smoother surfaces are smaller than a pixel.
const float LEAST_ROUGHNESS = 0.045;

// Returns the surface normal with the material's normal map applied, facing the camera.
vec3 surface_normal(Material m, vec3 to_camera) {
    vec3 n = normalize(normal);
    vec3 t = along_u - n * dot(n, along_u);
    if (has_image(m.normal_image) && dot(t, t) > 0.0) {
        t = normalize(t);
        vec3 b = cross(n, t);
        // Green points up, against v.
        b = dot(b, along_v) > 0.0 ? -b : b;
        vec3 bump = 2.0 * sample_image(m.normal_image, uv, false).xyz - 1.0;
        n = normalize(m.normal_scale * (bump.x * t + bump.y * b) + bump.z * n);
    }
    return dot(n, to_camera) < 0.0 ? -n : n;
}

void main() {
    Material m = materials[material];
    vec4 base = m.base;
    if (has_image(m.base_image)) {
        base *= sample_image(m.base_image, uv, true);
    }
    if (base.a < m.alpha_cutoff) {
        discard;
    }
    float metallic = m.metallic;
    float roughness = m.roughness;
    if (has_image(m.rough_image)) {
        vec4 image = sample_image(m.rough_image, uv, false);
        roughness *= image.g;
        metallic *= image.b;
    }
    vec3 to_camera = normalize(-from_camera);
    vec3 n = surface_normal(m, to_camera);
    vec3 to_light = light[0].xyz;
    vec3 between = normalize(to_camera + to_light);
    float nl = max(dot(n, to_light), 0.0);
    float nv = max(dot(n, to_camera), 1e-4);
    float nh = max(dot(n, between), 0.0);
    float vh = max(dot(to_camera, between), 0.0);

    float rough = max(roughness, LEAST_ROUGHNESS);
    float alpha2 = rough * rough * rough * rough;
    // GGX, the height-correlated Smith term over 4 nl nv, and Schlick's Fresnel term.
    float spread = nh * nh * (alpha2 - 1.0) + 1.0;
    float distribution = alpha2 / (PI * spread * spread);
    float visible = 0.5 / (nl * sqrt(nv * nv * (1.0 - alpha2) + alpha2) + nv * sqrt(nl * nl * (1.0 - alpha2) + alpha2) + 1e-7);
    vec3 straight = mix(vec3(0.04), base.rgb, metallic);
    float grazing = (1.0 - vh) * (1.0 - vh);
    vec3 fresnel = straight + (1.0 - straight) * (grazing * grazing * (1.0 - vh));
    vec3 diffuse = (1.0 - fresnel) * (1.0 - metallic) * base.rgb;
    vec3 lit = light[1].rgb * nl * (diffuse + PI * distribution * visible * fresnel) + light[1].a * base.rgb;
    vec3 glow = m.glow.rgb;
    if (has_image(m.glow_image)) {
        glow *= sample_image(m.glow_image, uv, true).rgb;
    }
    lit = clamp(m.glow.w > 0.0 ? base.rgb : lit + glow, 0.0, 1.0);
#if KEY_OF == KEY_OF_DISTANCE
    // Splats are ordered by the distance, and the mesh among them.
    float key = length(from_camera);
    gl_FragDepth = camera.depth.x / key;
#else
    float key = depth;
#endif
    surface = vec4(encode(lit.r), encode(lit.g), encode(lit.b), key);
}
