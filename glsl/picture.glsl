// Coordinates in a picture: -1 to 1 on both axes, y upwards.

// The centre of a sample. `at`: its column and row, of `samples` in the whole picture.
vec2 place_of_sample(uvec2 at, uvec2 samples) {
    vec2 place = vec2(2 * at + 1) / vec2(samples) - 1.0;
    return vec2(place.x, -place.y);
}
