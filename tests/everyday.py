"""Which cases of heavy families of tests run every time; the others are slow and run with `-m slow`.

Each has a lighter sibling on the same route that runs by default: another case of the same test, or another test of the
same room. Continuous integration runs them all.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable

EVERY_TIME: dict[str, dict[str, tuple[str, ...]]] = {
    "exporting/test_export.py": {
        "test_every_mesh_format_of_every_form_agrees_with_its_design": ("paper-a-covered.toml",),
        "test_same_design_and_options_give_the_same_bytes_in_every_format": (),
        "test_an_interrupted_export_ends_and_leaves_nothing": ("forecast-15",),
        "test_whichever_write_fails_only_complete_files_appear": (),
        "test_a_hexagonal_disc_is_exported": (),
    },
    "exporting/test_export_roles.py": {
        "test_a_design_whose_exact_surfaces_miss_the_law_has_no_master_mesh": (),
        "test_auto_gives_the_paper_s_sheet_256_quads_in_a_3mf_that_is_small_and_its_stl_the_finest_that_fits": (),
        "test_bytes_of_3mf_and_glb_are_forecast_within_a_fifth": ("8-slab-cells1",),
    },
    "exporting/test_marks_mesh.py": {
        "test_a_wide_thin_plate_alone_in_its_file_is_as_good_as_its_heights_are": (),
        "test_an_engraved_step_part_that_came_alone_has_lost_its_letters_and_nothing_else": (),
        "test_without_room_both_formats_say_what_is_missing_and_write_nothing": (),
        "test_verification_accepts_engraved_files_and_states_what_the_letters_take": (),
        "test_an_engraved_file_that_came_alone_is_known_by_its_shape": ("array1",),
        "test_an_engraved_mesh_is_one_solid_that_lost_its_letters_and_nothing_of_its_lenses": ("hexagonal",),
    },
    "exporting/test_strangers.py": {
        "test_a_slicer_calls_saddled_sheets_manifold_and_repairs_nothing": (),
    },
    "formats/test_readers.py": {
        "test_the_same_mesh_gives_the_same_bytes_in_another_process": (".ply",),
    },
    "formats/test_step.py": {
        "test_the_forecast_is_right_within_a_tenth": ("instanced",),
        "test_a_written_file_reads_back_as_the_designed_solids": ("instanced-AP242-True",),
        "test_fused_and_instanced_files_hold_the_same_volume_and_the_same_lenses": (
            "{'eta': (0.5, 0.3), 'thickness': 0.3}",
        ),
        "test_steps_of_any_height_survive_writing_and_reading": ("2.9619362959451737e-08",),
    },
    "formats/test_step_forms.py": {
        "test_walls_of_islands_are_planes_where_the_arc_leaves_the_web_steeply": ("form3-20.0-False",),
        "test_every_form_reads_back_valid_with_its_integral_and_its_closed_form": ("Galilean",),
    },
    "mesh/test_mesh.py": {
        "test_no_tilt_from_a_billionth_of_a_degree_to_20_degrees_leaves_an_open_edge": ("slab",),
        "test_the_volume_missing_from_the_facets_falls_fourfold_when_they_are_halved": ("strips",),
        "test_grids_too_coarse_for_the_rims_are_still_closed": ("3",),
        "test_every_form_is_closed_also_after_a_float32_file": (
            "slab, seam",
            "outline that fits two sides",
            "cylinders",
        ),
        "test_counts_without_expanding_are_those_of_the_stream_and_of_the_index": (
            "slab, displaced in x and y",
        ),
        "test_optical_vertices_lie_on_the_exact_surfaces": ("strips",),
        "test_pieces_holes_and_volume_are_those_of_another_kernel": ("strips",),
    },
    "mesh/test_mesh_bevel.py": {
        "test_the_manifest_counts_saddles_and_says_what_was_done": (),
        "test_strict_readers_take_bevelled_and_touching_saddles": (),
        "test_bevelled_sheets_are_watertight_as_float32_files": ("2e-05-3-slab",),
    },
    "rendering/test_atlas.py": {
        "test_a_figure_shows_what_the_paper_says": (),
    },
    "rendering/test_render.py": {
        "test_the_fitted_map_of_a_view_is_the_independent_tracer_s": ("z_k_2",),
        "test_the_homogeneous_sheet_shows_the_ideal_law": ("z_k_20",),
        "test_a_view_is_the_independent_renderer_s_picture": ("z_k_2",),
    },
    "rendering/test_render_pov.py": {
        "test_single_rays_have_the_colour_that_povray_finds": ("base",),
        "test_every_form_of_sheet_shows_the_rays_that_povray_finds": ("plano",),
    },
    "rendering/test_render_scale.py": {
        "test_memory_does_not_grow_with_the_number_of_lenslets": ("True",),
    },
    "report/test_report_parts.py": {
        "test_the_picture_shows_every_body": ("plano",),
    },
    "tracing/test_trace_mesh.py": {
        "test_every_ray_does_what_all_triangles_together_say": ("offset",),
        "test_facets_converge_at_first_order_and_vertex_normals_at_second": ("plano outside-vertex-2.0",),
        "test_triangles_from_anywhere_do_what_the_sheets_own_mesh_does": ("plano outside",),
    },
    "tracing/test_trace_walk.py": {
        "test_the_walk_ends_where_a_march_in_small_steps_ends": ("offset",),
    },
    "tracing/test_trace_kernels.py": {
        "test_single_precision_shows_the_same_light_to_a_microradian": (),
    },
    "trust/test_command_line.py": {
        "test_json_is_all_there_is_on_stdout_and_the_log_is_json_on_stderr": (),
        "test_a_crash_of_the_kernel_is_70_in_one_sentence_and_the_other_files_are_written": (),
        "test_a_file_size_limit_is_4_whatever_file_meets_it": ("500",),
        "test_a_mistake_of_our_own_is_70_and_v_tells_where": (),
        "test_a_kernel_without_memory_is_70_in_one_sentence_and_the_other_files_are_written": (),
        "test_a_format_that_the_design_cannot_have_is_said_and_the_others_are_written": (
            "baffle-plano-no baffle",
        ),
        "test_a_folder_that_cannot_be_one_is_4": ("/dev/null/out",),
        "test_too_many_lenslets_are_3_before_anything_is_loaded_that_could_build_or_trace_them": (
            "trace DESIGN RAYS -o OUT/o.npz-1e18",
        ),
    },
    "trust/test_failing_writes.py": {
        "test_a_file_size_limit_is_raised_until_all_is_written": (),
        "test_a_small_disk_is_emptied_page_by_page_until_all_is_written": (),
    },
    "trust/test_interruptions.py": {
        "test_whatever_a_library_makes_of_an_interruption_it_is_one": ("another error",),
        "test_every_long_command_can_be_interrupted_and_leaves_nothing": ("accuracy",),
        "test_an_interrupted_export_is_130_and_leaves_nothing": ("2-stl-forecast",),
    },
    "trust/test_kill.py": {
        "test_whole_commands_killed_at_any_instant": (),
    },
    "trust/test_mutations.py": {
        "test_unchanged_files_pass_with_a_manifest_and_without": ("tiny.stl",),
        "test_a_changed_mesh_is_caught_with_a_manifest_that_vouches_for_it_and_without_any": (
            "tiny.glb-facet turned over",
            "tiny.3mf-x 25.4",
        ),
        "test_a_failing_hash_fails_the_whole_report": ("tiny.3mf",),
        "test_a_lenslet_in_a_wrong_place_is_caught": ("glb: lenslet twice",),
        "test_a_changed_solid_is_caught_with_a_manifest_that_vouches_for_it": ("x 25.4",),
    },
    "trust/test_mutations_of_maps.py": {
        "test_a_changed_number_is_caught_with_a_manifest_that_vouches_for_it_and_without_any": (
            "calibration: its step",
        ),
        "test_unchanged_ones_pass_with_a_manifest_and_without": ("tiny.sheet-back.mask.svg",),
    },
    "trust/test_soak.py": {
        "test_a_random_design_is_exported_and_verified": (),
    },
    "trust/test_verdict_of_meshes.py": {
        "test_the_bench_s_own_triangles_grow_into_its_own_faces": (),
        "test_a_mesh_is_a_master_where_light_through_its_triangles_keeps_the_limits": ("tilted-32",),
        "test_a_step_file_of_a_design_that_passes_is_a_master": (),
        "test_the_bench_s_own_tracer_finds_what_was_measured_before_it": ("slab-8-14.0",),
    },
    "trust/test_verdicts.py": {
        "test_the_verdict_is_the_one_that_is_optically_right": (
            'manifest says format "coupon": damaged stl',
            'manifest says role "other": coarse stl',
            'manifest says bodies ["x"]: damaged stl',
            "bytes changed after the manifest: ply",
            "manifest lists an empty entry",
            "coarse, declared in its manifest: slab glb",
            "coarse, declared in its manifest: slab ply",
            "manifest says no bodies: coarse stl",
        ),
    },
    "trust/test_whole_export.py": {
        "test_the_bytes_do_not_depend_on_circumstances": (),
        "test_the_bytes_do_not_depend_on_the_user": (),
        "test_thin_bodies_far_apart_are_0": (),
    },
    "verification/test_file_light.py": {
        "test_the_shift_that_was_made_is_the_shift_that_is_found": ("-0.01-slab",),
    },
    "verification/test_mesh_instances.py": {
        "test_a_sheet_of_40_000_cells_is_read_and_judged_without_expanding_it": (),
        "test_noise_of_a_tenth_of_a_micrometre_fails_where_the_honest_file_passes": ("8",),
        "test_wrong_stored_normals_fail": ("x and y negated-glb",),
        "test_stored_normals_are_judged_by_their_angle_to_the_sphere": (),
        "test_errors_that_a_manifest_states_too_large_widen_no_limit": ("sag",),
        "test_a_survey_of_40_000_cells_has_their_box_and_the_corners_of_their_hull_however_they_lie": (),
        "test_a_repeated_cell_gets_the_verdict_of_all_cells_written_out": ("plano-glb",),
        "test_one_instance_in_a_wrong_place_fails_placement": ("3mf-beside the sheet",),
    },
    "verification/test_registration.py": {
        "test_a_scan_goes_through": (),
        "test_wrong_parts_are_named": (),
        "test_the_deviation_map_is_a_picture_and_a_table": (),
        "test_the_pose_is_found_and_undone": ("as written",),
    },
    "verification/test_returned_parts.py": {
        "test_a_copy_of_an_exported_mesh_lies_as_it_was_written": ("window-100mm",),
        "test_a_part_turned_about_an_oblique_axis_is_found_and_judged_right": ("round",),
        "test_a_disc_turned_about_its_normal_is_found_by_its_lenses": (),
        "test_a_piece_sawn_askew_is_found_by_its_lenses": (),
        "test_dents_are_listed_with_depth_place_and_cell_face_by_face": (),
        "test_a_turned_mirror_image_is_still_told": (),
        "test_a_turned_part_is_found_in_any_unit": ("1e-06-um",),
        "test_a_drilled_piece_is_recognised_and_its_hole_named": ("as it lay",),
        "test_a_good_part_does_not_fail_shape_by_where_it_lies": ("plano-turned a quarter",),
    },
    "verification/test_step_strangers.py": {
        "test_a_piece_with_a_drilled_hole_is_recognised_and_the_hole_is_named": (),
        "test_one_row_of_instances_off_the_lattice_is_named_with_its_cell_and_distance": (),
        "test_lens_faces_that_another_program_fitted_closely_pass_by_their_light": (),
        "test_one_body_moved_by_a_two_hundredth_of_the_separation_fails": ("x-MM",),
        "test_a_cell_left_out_and_a_cell_put_twice_are_named": (),
        "test_a_part_a_thousandth_too_small_fails": ("INCH-assembly",),
        "test_a_kernel_s_own_file_gets_the_same_rows": ("one-fused",),
        "test_lens_faces_that_another_program_fitted_badly_fail": (),
        "test_a_good_part_written_again_passes_as_an_optical_master_in_any_unit_and_structure": (
            "INCH-one-assembly",
        ),
        "test_light_through_the_patches_of_the_text_goes_where_the_kernel_sends_it": ("one",),
    },
    "verification/test_verify_files.py": {
        "test_a_file_of_another_design_fails_by_name": ("delta of the other sign",),
        "test_a_spoilt_file_fails_by_name": ("empty",),
    },
    "verification/test_verify_optics.py": {
        "test_a_wrong_window_is_caught_by_name": ("turned by 90 degrees",),
        "test_meridians_turned_with_delta_to_suit_fail_tilt_alone_and_the_right_ones_pass": (
            "one virtual focus",
        ),
    },
    "verification/test_verify_shop.py": {
        "test_a_part_whose_lenses_were_made_ten_per_cent_flatter_is_not": ("stl",),
        "test_a_true_file_of_any_format_is_the_design": ("obj",),
    },
}
"""By file and test the cases that run by default; none: the whole test is slow."""


def slow_and_unknown(cases: Iterable[tuple[str, str, str]]) -> tuple[list[int], list[str]]:
    """Say which cases are slow, and which names above are of no case.

    Parameters
    ----------
    cases : iterable of (file below tests/, test, case)

    Returns
    -------
    slow : list of int
        Places in `cases`.
    unknown : list of str
        Of tests that have cases here, those that are named above and are not among them.
    """
    slow, found = [], defaultdict(set)
    for place, (file, test, case) in enumerate(cases):
        kept = EVERY_TIME.get(file, {}).get(test)
        if kept is not None:
            found[file, test].add(case)
            if case not in kept:
                slow.append(place)
    unknown = [
        f"{file}::{test}[{case}]"
        for (file, test), there in found.items()
        for case in EVERY_TIME[file][test]
        if case not in there
    ]
    return slow, unknown
