"""Mutants of reconstruction: conditioning, sampling, medium, geometry, responses, solvers, weights, limits."""

from support.mutants import Mutant

SHARE = "imaging/test_highest_frequency.py::test_share_of_power_above_a_frequency_counts_negative_frequencies"

MUTANTS = {
    "offset of the whole record": Mutant(
        "imaging.signal.conditioning:Conditioning.apply",
        "live -= live.mean(axis=1",
        "live -= data.mean(axis=1",
        ("imaging/test_conditioning.py::test_offset_is_that_of_the_samples_that_are_not_zeroed",),
    ),
    "the band's upper edge is open": Mutant(
        "imaging.signal.conditioning:Conditioning.gain",
        "if high > 0:",
        "if high < 0:",
        ("imaging/test_conditioning.py::test_the_band_passes_inside_and_stops_outside_without_a_delay",),
    ),
    "rim of the whole aperture": Mutant(
        "imaging.signal.conditioning:rim_weights",
        "np.float64) / 2 - np.abs",
        "np.float64) - np.abs",
        ("imaging/test_conditioning.py::test_the_rim_fades_to_zero_at_the_sides_only",),
    ),
    "a filter that wraps": Mutant(
        "imaging.signal.conditioning:_filter",
        "2 * samples, axis=1)[:, :samples]",
        "2 * samples, axis=1)[:, samples:]",
        ("imaging/test_conditioning.py::test_the_band_passes_inside_and_stops_outside_without_a_delay",),
    ),
    "decimation without its factor": Mutant(
        "imaging.signal.bandwidth:decimate",
        "[:, :samples] / factor",
        "[:, :samples]",
        ("imaging/test_iterative.py::test_thinned_traces_are_the_same_signal_and_refining_undoes_it",),
    ),
    "negative frequencies have no power": Mutant(
        "imaging.signal.bandwidth:power_fraction_above",
        "*= 2 ",
        "*= 1 ",
        (f"{SHARE}[64]",),
    ),
    "noise of the lower quarter": Mutant(
        "imaging.signal.bandwidth:signal_band",
        "power[-max(1, len(power) // 4) :]",
        "power[: max(1, len(power) // 4)]",
        ("imaging/test_iterative.py::test_the_band_of_noisy_traces_and_their_noise_are_found",),
    ),
    "time in the layers above counts again": Mutant(
        "imaging.medium:Medium.depth_at",
        "depth + layer.thickness, time - needed",
        "depth + layer.thickness, time",
        ("imaging/test_layers.py::test_late_record_through_layers_shows_the_ball_in_place",),
    ),
    "transmission upside down": Mutant(
        "imaging.medium:LayerPath.transmission",
        "2 * above",
        "2 * below",
        ("imaging/test_layers.py::test_densities_restore_amplitudes_that_transmission_takes",),
    ),
    "no critical angle": Mutant(
        "imaging.medium:LayerPath.critical_angle",
        "fastest > self.sound_speed",
        "fastest < self.sound_speed",
        ("imaging/test_layers.py::test_layered_image_states_which_angles_are_not_heard",),
    ),
    "a late record begins a sample early": Mutant(
        "imaging.geometry.depth_extent:Extent.ahead",
        "ceil(self.begins)",
        "int(self.begins)",
        (
            "imaging/test_late_records.py::test_usual_depths_reach_to_the_record_s_end_and_from_the_film_or_a_late_record_s_begin[25.5-26-126]",
        ),
    ),
    "no record counts as late": Mutant(
        "imaging.geometry.depth_extent:Extent.late",
        "self.begins > LATE * self.samples",
        "False",
        (
            "imaging/test_late_records.py::test_usual_depths_reach_to_the_record_s_end_and_from_the_film_or_a_late_record_s_begin[26-26-126]",
        ),
    ),
    "large primes stay": Mutant(
        "imaging.transforms.grid_sizes:fast_record_length",
        "MAX_PRIME + 1",
        "samples + 1",
        ("imaging/test_lengths.py::test_no_length_needs_a_slow_transform[1021]",),
    ),
    "sensors beside a grid count as on it": Mutant(
        "imaging.geometry.sensor_areas:detect_sensor_grid",
        "> _OFF_GRID",
        "> 0.5",
        ("imaging/test_plan.py::test_grid_with_a_displaced_line_is_not_a_grid",),
    ),
    "rim of half a spacing forgotten": Mutant(
        "imaging.geometry.sensor_areas:sensed_region",
        "_mean_spacing(bare, count) / 2",
        "0.0",
        (
            "imaging/test_plan.py::test_cells_of_a_line_end_half_a_mean_spacing_beyond_it_and_sensors_at_one_place_share_theirs",
        ),
    ),
    "the memory limit is twice as large": Mutant(
        "imaging.compute.memory_limit:check_memory",
        "if needed > limit:",
        "if needed > 2 * limit:",
        ("imaging/test_plan.py::test_memory_estimate_matches_peak_and_lower_limit_is_refused[1]",),
    ),
    "projection along x": Mutant(
        "imaging.volume:Volume.mip",
        "self.names.index(axis)",
        "0",
        ("imaging/test_plan.py::test_each_mip_removes_its_own_axis",),
    ),
    "more noise than the gain allows": Mutant(
        "imaging.film_response:InverseFilter.evaluate",
        "0.25 / self.max_gain",
        "0.0025 / self.max_gain",
        ("imaging/test_response.py::test_inverse_filter_noise_gain_is_bounded[2.0]",),
    ),
    "phase of a response not undone": Mutant(
        "imaging.film_response:InverseFilter.evaluate",
        "np.conj(s)",
        "s",
        ("imaging/test_response.py::test_a_complex_filter_shifts_every_wave_by_its_phase",),
    ),
    "a sensor twice": Mutant(
        "imaging.incremental:IncrementalReconstruction._checked",
        "self.measured[which].any() or ",
        "",
        ("imaging/test_growing.py::test_invalid_add_is_refused_and_keeps_volume[sensors1-1-sensors]",),
    ),
    "the area of missing sensors is lost": Mutant(
        "imaging.incremental:IncrementalReconstruction._wanted",
        "if self._neighbours is not None:",
        "if False:",
        (
            "imaging/test_growing.py::test_where_half_the_points_of_one_side_are_missing_the_others_there_stand_for_them",
        ),
    ),
    "negative pressure stays": Mutant(
        "imaging.iterative.proximal:proximal",
        "if non_negative:\n            np.max",
        "if False:\n            np.max",
        ("imaging/test_iterative.py::test_proximal_step_keeps_negative_values_only_where_they_are_allowed",),
    ),
    "samples before the pulse are fitted": Mutant(
        "imaging.iterative.solve:_since_pulse",
        "if not before:",
        "if True:",
        ("imaging/test_late_records.py::test_iterative_image_leaves_out_samples_before_the_pulse",),
    ),
    "attenuation without dispersion": Mutant(
        "imaging.attenuation:Attenuation.decay",
        "/ cos(pi * y / 2) - tan(pi * y / 2) * s / omega",
        "/ cos(pi * y / 2)",
        ("imaging/test_attenuation.py::test_dispersion_is_the_kramers_kronig_integral",),
    ),
    "layers above are not heard in time": Mutant(
        "imaging.transforms.extrapolation:plan_extrapolation",
        "table[0, -1] = gap",
        "table[0, -1] = 2 * gap + 1e-4",
        ("imaging/test_layered_model.py::test_model_of_layers_gives_the_a_lines_of_rays",),
    ),
    "the spot is as wide as its radius": Mutant(
        "imaging.sensing_spot:SensingSpot.evaluate",
        "self.diameter / 2",
        "self.diameter / 4",
        ("imaging/test_sensing_spot.py::test_response_is_the_mean_of_a_plane_wave_over_the_beam",),
    ),
}
