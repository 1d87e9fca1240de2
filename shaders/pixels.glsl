// The sums that a rasteriser writes per pixel besides the colour, if outputs are requested: over its splats, near to far. outputs.comp
// makes images of them. Weights are alpha times the transmittance before the splat. See docs/splatting.md.

// A placeholder in parameter lists for a parameter that exists only with outputs.
#if WITH_OUTPUTS
#define AND(parameter) , parameter
#else
#define AND(parameter)
#endif

#if WITH_OUTPUTS
struct Pixel {
    float light;         // the transmittance after all splats
    float depth;         // sum of weight times view depth
#if WITH_MESH
    float limit;         // view depth of the mesh, where splats end
#endif
#if WITH_NORMALS
    float normal_x, normal_y, normal_z;  // sum of weight times normal
#endif
#if WITH_RANKS
    float median;        // depth of the last splat with a transmittance above one half before it
    float most;          // the largest weight
    uint index;          // the splat with that weight
    uint contributors;   // splats in front of the early stop
#endif
};

// The inputs of these sums, per splat.
struct Seen {
    float depth;
    uint index;
    vec3 normal;
};

const uint NO_SPLAT = 0xffffffffu;

// Returns the pixel without splats.
Pixel empty_pixel() {
    Pixel p;
    p.light = 1.0;
    p.depth = 0.0;
#if WITH_MESH
    p.limit = 0.0;
#endif
#if WITH_NORMALS
    p.normal_x = p.normal_y = p.normal_z = 0.0;
#endif
#if WITH_RANKS
    p.median = 0.0;
    p.most = 0.0;
    p.index = NO_SPLAT;
    p.contributors = 0u;
#endif
    return p;
}

// Adds a splat with this weight (0 if it is not blended) and the transmittance before it. A splat that brings the transmittance below
// `stop` is not counted, nor any behind it, whether or not they are blended: so the count does not depend on where the loop ends.
void add_splat(inout Pixel p, Seen s, float weight, float before, float stop) {
    p.depth += weight * s.depth;
#if WITH_NORMALS
    p.normal_x += weight * s.normal.x;
    p.normal_y += weight * s.normal.y;
    p.normal_z += weight * s.normal.z;
#endif
#if WITH_RANKS
    bool is_blended = weight > 0.0;
    p.median = is_blended && before > 0.5 ? s.depth : p.median;
    p.index = weight > p.most ? s.index : p.index;
    p.most = max(p.most, weight);
    p.contributors += is_blended && before - weight >= stop ? 1u : 0u;
#endif
}
#endif
