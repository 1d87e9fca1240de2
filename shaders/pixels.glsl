// What a rasteriser leaves of a pixel besides its colour, where outputs are asked for: the sums over its splats, near to far, that
// outputs.comp makes images of. Weights are alpha times the transmittance before the splat. See docs/splatting.md.

// Stands in lists of parameters for one that is there with outputs alone.
#if WITH_OUTPUTS
#define AND(parameter) , parameter
#else
#define AND(parameter)
#endif

#if WITH_OUTPUTS
struct Pixel {
    float light;         // the transmittance behind all splats
    float depth;         // sum of weight times view depth
#if WITH_NORMALS
    float normal_x, normal_y, normal_z;  // sum of weight times normal
#endif
#if WITH_RANKS
    float median;        // depth of the last splat that more than half of the light reaches
    float most;          // the largest weight
    uint index;          // the splat that has it
    uint contributors;   // splats that were blended
#endif
};

// A splat as these sums see it.
struct Seen {
    float depth;
    uint index;
    vec3 normal;
};

const uint NO_SPLAT = 0xffffffffu;

// Returns a pixel that no splat touches.
Pixel empty_pixel() {
    Pixel p;
    p.light = 1.0;
    p.depth = 0.0;
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

// Adds a splat of this weight, which is 0 where it is not blended, with the transmittance before it.
void add_splat(inout Pixel p, Seen s, float weight, float before) {
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
    p.contributors += is_blended ? 1u : 0u;
#endif
}
#endif
