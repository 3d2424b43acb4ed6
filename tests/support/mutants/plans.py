"""Mutants of scan plans: fringes, bands, orders, timing, findings, tuning maps."""

from support.mutants import Mutant

MUTANTS = {
    "the flank below is read above": Mutant(
        "plans.fringe:Fringe.sensitivity_loss",
        'detuning if self.flank == "above" else -detuning',
        "detuning",
        ("plans/test_bands.py::test_sensitivity_loss_matches_fringe_slope_ratio[None-below]",),
    ),
    "steepest point of a Lorentzian": Mutant(
        "plans.fringe:Fringe.steepest",
        "np.sqrt(12)",
        "np.sqrt(10)",
        ("plans/test_bands.py::test_sensitivity_loss_matches_fringe_slope_ratio[None-above]",),
    ),
    "tolerances of the two sides exchanged": Mutant(
        "plans.fringe:Fringe.wavelength_tolerance",
        '(inward, outward) if self.flank == "above" else (outward, inward)',
        "(outward, inward)",
        ("plans/test_bands.py::test_sensitivity_loss_matches_fringe_slope_ratio[None-above]",),
    ),
    "tolerance held on the other side": Mutant(
        "plans.wavelength_bands:hold_wavelength",
        "now - optimum",
        "optimum - now",
        ("plans/test_bands.py::test_hold_wavelength_changes_only_outside_tolerance",),
    ),
    "bands by number alone": Mutant(
        "plans.wavelength_bands:partition_bands",
        "+ spread ",
        "",
        ("plans/test_bands.py::test_partition_bands_minimizes_loss_for_fewest_bands",),
    ),
    "moves begin a pulse early": Mutant(
        "plans.motion_timing:MotionTiming.periods",
        "np.ceil",
        "np.floor",
        ("plans/test_plan.py::test_a_move_longer_than_the_pulse_period_costs_a_second_period",),
    ),
    "settling is forgotten": Mutant(
        "plans.motion_timing:MotionTiming.move_times",
        " + self.motion.settling",
        "",
        ("plans/test_plan.py::test_a_move_longer_than_the_pulse_period_costs_a_second_period",),
    ),
    "averages are forgotten": Mutant(
        "plans.preview:preview",
        "shots * plan.averages * period",
        "shots * period",
        ("plans/test_plan.py::test_preview_counts_pulses_and_bytes",),
    ),
    "frames are not part of the identifier": Mutant(
        "plans.plan:ScanPlan.id",
        "if self.frames == 1:",
        "if True:",
        ("plans/test_frames.py::test_plan_id_changes_with_multiple_frames_or_excitation",),
    ),
    "a record one sample short": Mutant(
        "plans.validation:_samples_for",
        " + 1",
        "",
        ("plans/test_findings.py::test_records_that_end_too_early_warn_or_refuse",),
    ),
    "a tight disk refuses": Mutant(
        "plans.validation:_disk",
        "free < need",
        "free < DISK_MARGIN * need",
        ("plans/test_findings.py::test_a_disk_too_small_refuses_and_a_tight_one_warns",),
    ),
    "spacing against the whole resolution": Mutant(
        "plans.validation:_spacing",
        "spacing > resolution / 2",
        "spacing > resolution",
        ("plans/test_findings.py::test_a_spacing_too_wide_for_the_resolution_warns",),
    ),
    "strips all in one direction": Mutant(
        "plans.curve_orders:boustrophedon",
        "np.where(strip % 2 == 0, y, -y)",
        "y",
        ("plans/test_plan.py::test_snake_travels_less_than_the_rings",),
    ),
    "groups joined at the far end": Mutant(
        "plans.tour:concatenate",
        "ends[0] <= ends[1]",
        "ends[0] > ends[1]",
        ("plans/test_order.py::test_concatenated_tours_begin_at_the_end_that_is_nearer",),
    ),
    "uncertainty of a map halved twice": Mutant(
        "plans.tuning_map:TuningMap.at",
        "np.sqrt((",
        "0.25 * np.sqrt((",
        ("plans/test_tuning_map.py::test_tuning_map_interpolation_error_matches_uncertainty",),
    ),
    "rows and columns of a matrix exchanged": Mutant(
        "plans.text_tuning_map:read_text_map",
        "[columns - middle[1], rows - middle[0]]",
        "[rows - middle[0], columns - middle[1]]",
        ("plans/test_text_map.py::test_text_matrix_of_wavelengths_becomes_a_map_around_the_origin[,-False]",),
    ),
    "crowding without distance": Mutant(
        "plans.progressive_order:_eliminate",
        "np.maximum(1 - distance / reach, 0)",
        "np.maximum(distance / reach, 0)",
        ("plans/test_progressive.py::test_every_prefix_is_spread_as_evenly_as_a_mask_of_its_size",),
    ),
    "prefix of the mask's own order": Mutant(
        "plans.plan:ScanPlan.truncated_mask",
        "self.visit[:points].tolist()",
        "list(range(points))",
        ("plans/test_progressive.py::test_truncated_mask_has_the_first_visited_points",),
    ),
    "wavelength of the first beam": Mutant(
        "plans.plan:ScanPlan._tuned_together",
        ".mean(axis=1)",
        "[:, 0]",
        ("plans/test_beams.py::test_all_beams_of_a_place_are_read_at_one_wavelength_and_the_loss_of_each_is_stated",),
    ),
}
