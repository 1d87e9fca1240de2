// A vertex of egui's meshes. Colours are display-encoded and premultiplied, packed as rgba8.
struct Vertex {
    vec2 position;  // in pixels of the window
    vec2 uv;        // 0 to 1 across the texture
    uint colour;
    uint clip;      // index of its clip
};

// The clip rectangle of a mesh, and its texture.
struct Clip {
    vec2 first;     // the top left pixel that may be drawn to
    vec2 beyond;    // the pixel below and to the right of the last one
    uint texels;    // the texture's first texel among all textures' texels
    uint width;     // of the texture, in texels
    uint height;
    uint smoothing; // below
};

const uint SMOOTH_MAGNIFIED = 1u;
const uint SMOOTH_MINIFIED = 2u;
