//! Configuration of global primitives: how vanishing points become directions of the world.

use vision::vanishing::VanishingConfig;

/// Global primitives: directions shared by keyframes. [method: Global primitives]
#[derive(Clone, Debug, PartialEq)]
pub struct PrimitiveConfig {
    /// How vanishing points are found.
    pub vanishing: VanishingConfig,
    /// Largest angle between vanishing point and primitive, in standard deviations of both. Default 3.
    pub gate_sigmas: f64,
    /// That angle is never less than this, degrees. Default 2: attitudes drift a little.
    pub min_gate_deg: f64,
    /// That angle is never more than this, degrees. Default 5.
    pub max_gate_deg: f64,
    /// The angle allowed when lines of the primitive vote for it, degrees. Default 10.
    pub voted_gate_deg: f64,
    /// How many lines must vote. Default 3.
    pub min_votes: usize,
    /// The second best primitive must be this many times farther off. Default 2.
    pub min_runner_up_ratio: f64,
    /// Keyframes that must share a direction to make a primitive. Default 3: a single frame shows one chance
    /// direction in two.
    pub min_keyframes: usize,
    /// Segments that must support it in one of them. Default 5.
    pub min_segments: usize,
    /// Primitives closer than this are one, unless a keyframe shows both, degrees. Default 1.5.
    pub merge_deg: f64,
    /// Primitives that fewer keyframes show are dropped when they are not seen again. Default 5.
    pub min_keyframes_to_keep: usize,
    /// After how many keyframes without sight they are dropped. Default 20.
    pub retire_after_keyframes: u64,
    /// Largest angle between a line and the primitive its segments vote for, degrees. Default 3.
    pub max_line_angle_deg: f64,
    /// Standard deviation of the angle between a line and its primitive, degrees. Default 1: buildings are no
    /// truer.
    pub line_sigma_deg: f64,
    /// Standard deviation of a segment's end, as far as its direction is concerned, in those of the segment:
    /// at least this. Default 1.
    pub segment_sigma_factor: f64,
    /// The same in those by which the primitive's segments are seen to scatter, where that is more. Default
    /// 2: an edge that is not quite parallel errs alike in all the keyframes that show it, so these count
    /// for fewer than they are.
    pub scatter_sigma_factor: f64,
    /// How many of the keyframes that show a primitive, newest first, tell how its segments scatter. Default
    /// 20: it is asked for every frame.
    pub max_keyframes_of_scatter: usize,
    /// Iterations of the second stage of local bundle adjustment. Default 2: it starts from the first one's
    /// result.
    pub stage_two_iterations: usize,
    /// At the end of a recording, submaps of up to this many keyframes are adjusted as a whole by their
    /// primitives. Default 500: adjustment takes some 3 ms a keyframe, and the recording's end waits for it.
    pub max_keyframes_to_adjust: usize,
    /// Primitives may turn the newest keyframe by this many standard deviations of its own attitude.
    /// Default 3.
    pub max_turn_sigmas: f64,
}

impl Default for PrimitiveConfig {
    fn default() -> Self {
        Self {
            vanishing: VanishingConfig::default(),
            gate_sigmas: 3.0,
            min_gate_deg: 2.0,
            max_gate_deg: 5.0,
            voted_gate_deg: 10.0,
            min_votes: 3,
            min_runner_up_ratio: 2.0,
            min_keyframes: 3,
            min_segments: 5,
            merge_deg: 1.5,
            min_keyframes_to_keep: 5,
            retire_after_keyframes: 20,
            max_line_angle_deg: 3.0,
            line_sigma_deg: 1.0,
            segment_sigma_factor: 1.0,
            scatter_sigma_factor: 2.0,
            max_keyframes_of_scatter: 20,
            stage_two_iterations: 2,
            max_keyframes_to_adjust: 500,
            max_turn_sigmas: 3.0,
        }
    }
}
