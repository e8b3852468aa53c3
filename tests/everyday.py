"""Which cases of heavy families of tests run every time; the others are slow and run with `-m slow`.

Each has a lighter sibling on the same route that runs by default: another case of the same test, or another test of the
same room. Continuous integration runs them all, but those whose siblings in their turn are slow and tell as much: they run
by hand, with `-m long`.

Of the tracer's kernels those of exact surfaces and of the ideal rungs alone are compiled by default: a fresh machine takes half a
minute for each of the others (facets, triangles, pictures, cells that differ), and their tests are slow.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass

EVERY_TIME: dict[str, dict[str, tuple[str, ...]]] = {
    "advice/test_hints_and_fixes.py": {
        "test_each_key_that_is_advised_makes_all_the_rays_of_verify_pass_and_is_one_key": (),
        "test_a_slab_of_ellipsoids_is_told_of_the_conic_constant_that_costs_nothing": ("slab-1.2",),
        "test_a_fix_changes_the_fewest_keys_keeps_the_law_and_every_comment_and_passes": (),
        "test_what_is_no_slab_of_ellipsoids_is_told_of_nothing_that_costs_nothing": (),
    },
    "advice/test_wish.py": {
        "test_a_wish_comes_true_as_a_commented_file_that_verify_passes": (),
        "test_what_cannot_be_written_is_said_and_nothing_is": (
            "words0-2-a NAME is needed",
            "words4-2-must not hold",
        ),
    },
    "base/test_kernel_cache.py": {
        "test_processes_that_compile_at_once_find_their_own_code": (),
    },
    "base/test_rates.py": {
        "test_what_was_noted_changes_forecasts_and_no_byte_that_is_written": (),
    },
    "compat/test_compat.py": {
        "test_an_export_of_format_1_is_recognised_and_owned": (),
    },
    "design/test_design_properties.py": {
        "test_a_mutated_json_file_is_a_design_or_a_design_error": (),
    },
    "effects/test_effects.py": {
        "test_compiled_split_paths_carry_the_light_of_the_walked_ones": (
            "setting0-paper-a-covered",
            "setting0-plano",
            "setting0-hexagonal",
            "setting0-galilean",
            "setting1-slab",
            "setting1-paper-a-covered",
            "setting1-plano",
            "setting1-hexagonal",
            "setting1-galilean",
        ),
        "test_shares_of_all_paths_sum_to_one_without_noise": (
            "slab-0",
            "slab-1",
            "tilted-biconvex-0",
            "tilted-biconvex-1",
            "tilted-biconvex-3",
            "tilted-seam-0",
            "tilted-seam-1",
        ),
    },
    "effects/test_effects_bounds.py": {
        "test_bounds_hold_on_a_few_random_scenes": (),
    },
    "effects/test_effects_facets.py": {
        "test_facets_turn_light_by_what_is_forecast_and_never_much_more": (),
        "test_half_the_facets_size_turns_light_half_as_much": (),
        "test_losses_come_on_top_of_facets": (),
        "test_the_effect_is_rung_mesh_itself": (),
    },
    "explore/test_explorer_page.py": {
        "test_the_field_lens_is_in_the_design_file_that_check_reads": ("window-100mm",),
    },
    "exporting/test_export.py": {
        "test_every_mesh_format_of_every_form_agrees_with_its_design": ("paper-a-covered.toml",),
        "test_same_design_and_options_give_the_same_bytes_in_every_format": (),
        "test_an_interrupted_export_ends_and_leaves_nothing": ("forecast-15",),
        "test_whichever_write_fails_only_complete_files_appear": (),
        "test_a_hexagonal_disc_is_exported": (),
        "test_a_killed_export_leaves_no_half_file_and_the_next_one_cleans_up": (),
        "test_an_unreachable_slope_error_is_refused": (),
        "test_a_mesh_export_loads_no_kernel": (),
        "test_forecasts_hold": ("slab.toml",),
        "test_a_stranger_reads_every_mesh_with_the_volume_of_the_design": (),
        "test_the_exact_solids_come_out_with_the_integral_as_their_volume": (),
        "test_a_file_that_is_not_ours_is_refused_before_any_work": (),
        "test_manifold_and_lib3mf_accept_what_is_written": (),
        "test_auto_is_the_finest_grid_under_the_limits": (),
        "test_nothing_is_written_outside_the_folder_and_no_socket_is_opened": (),
    },
    "exporting/test_export_options.py": {
        "test_instances_of_a_glb_stand_where_its_nodes_do_and_take_less_room": (),
        "test_schema_and_parameter_curves_are_switches_of_the_command_line": (),
        "test_a_body_without_border_is_not_engraved_and_says_why": (),
        "test_an_engraved_body_is_valid_and_has_lost_its_letters_only": ("displaced slab",),
    },
    "exporting/test_export_roles.py": {
        "test_a_design_whose_exact_surfaces_miss_the_law_has_no_master_mesh": (),
        "test_auto_gives_the_paper_s_sheet_256_quads_in_a_3mf_that_is_small_and_its_stl_the_finest_that_fits": (),
        "test_bytes_of_3mf_and_glb_are_forecast_within_a_fifth": ("8-slab-cells1",),
        "test_the_command_prints_role_forecast_and_what_a_master_needs": (),
        "test_bytes_of_a_master_that_was_not_meshed_follow_from_a_coarser_one": (),
        "test_a_coarse_mesh_may_be_declared_a_master_and_the_command_warns": (),
        "test_auto_keeps_every_limit_of_light_not_the_rms_alone": (),
        "test_every_file_says_its_role_and_meshes_what_light_does": (),
        "test_a_dry_run_accepts_what_an_export_accepts": (
            "slab-cells0-stl-256",
            "slab-cells2-ply-128",
        ),
        "test_declared_roles_stand_in_the_manifest_and_are_carried_over": (),
        "test_the_convergence_check_says_from_how_many_quads_a_mesh_is_a_master_and_how_large_it_is": (),
        "test_light_through_facets_is_forecast_as_the_kernels_of_rung_mesh_trace_the_sheet": (),
    },
    "exporting/test_export_step.py": {
        "test_a_kernel_that_dies_is_a_sentence_and_nothing_is_published": (),
    },
    "exporting/test_fixture.py": {
        "test_the_frame_holds_the_plates_at_the_separation_and_nothing_collides": (),
    },
    "exporting/test_fused.py": {
        "test_a_fused_step_is_one_solid_where_the_sheet_is_one_piece": (),
    },
    "exporting/test_marks_mesh.py": {
        "test_a_wide_thin_plate_alone_in_its_file_is_as_good_as_its_heights_are": (),
        "test_an_engraved_step_part_that_came_alone_has_lost_its_letters_and_nothing_else": (),
        "test_without_room_both_formats_say_what_is_missing_and_write_nothing": (),
        "test_verification_accepts_engraved_files_and_states_what_the_letters_take": (),
        "test_an_engraved_file_that_came_alone_is_known_by_its_shape": (),
        "test_an_engraved_mesh_is_one_solid_that_lost_its_letters_and_nothing_of_its_lenses": ("hexagonal",),
        "test_the_same_design_gives_the_same_bytes": (),
        "test_the_letters_are_those_of_the_step_body_as_deep_and_at_their_place": (),
    },
    "exporting/test_rough_sizes.py": {
        "test_rough_sizes_are_near_the_close_ones": (
            "paper-base",
            "plano",
            "tilted-seam",
            "tilted-biconvex",
            "window-100mm",
        ),
    },
    "exporting/test_strangers.py": {
        "test_a_slicer_calls_saddled_sheets_manifold_and_repairs_nothing": (),
    },
    "formats/test_drawing.py": {
        "test_neither_hash_seed_nor_home_changes_a_byte_of_the_dxf": (),
    },
    "formats/test_plates.py": {
        "test_light_straight_down_meets_holes_land_and_air_where_plain_words_say": (),
        "test_slanted_light_ends_alike_on_every_path_and_through_its_triangles": (),
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
        "test_the_same_window_gives_the_same_bytes_in_any_process": (),
    },
    "formats/test_step_forms.py": {
        "test_walls_of_islands_are_planes_where_the_arc_leaves_the_web_steeply": ("form3-20.0-False",),
        "test_every_form_reads_back_valid_with_its_integral_and_its_closed_form": ("Galilean",),
    },
    "hard/test_hard_kernels.py": {
        "test_facets_give_the_same_fate_and_cell_and_nearly_the_same_direction": (),
        "test_facets_of_planes_are_exact": (),
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
        "test_the_quadrature_agrees_with_a_plain_midpoint_sum": (),
    },
    "mesh/test_mesh_bevel.py": {
        "test_the_manifest_counts_saddles_and_says_what_was_done": (),
        "test_strict_readers_take_bevelled_and_touching_saddles": (),
        "test_bevelled_sheets_are_watertight_as_float32_files": ("2e-05-3-slab",),
    },
    "optics/test_aperture.py": {
        "test_the_lit_zone_of_the_tilted_sheet_gives_the_fft_of_its_pixels": (),
    },
    "optimising/test_optimise.py": {
        "test_bad_options_are_told_and_nothing_is_written": (
            "words0-named twice",
            "words2-an angle such as",
            "words3--o better.toml",
        ),
    },
    "optimising/test_what_is_asked.py": {
        "test_the_command_writes_a_page_that_needs_no_network_and_says_whether_the_gain_survives": (),
        "test_a_field_with_more_weight_is_served_better": (),
        "test_bad_options_are_told_and_nothing_is_written": (
            "words0---weights a:1",
            "words2-above 0",
            "words4-[tolerances]",
        ),
    },
    "prescription/test_aimed_cells.py": {
        "test_the_window_from_400_mm_before_and_after_aiming": (),
    },
    "prescription/test_given_faces.py": {
        "test_golden_prescriptions_re_traced": (
            "numpy-window-100mm as designed",
            "numpy-window-100mm R free, sphere @1.0",
            "numpy-window-100mm R,K @1.0",
            "numpy-paper-a-covered bending + A4",
            "numba-window-100mm as designed",
            "numba-window-100mm R free, sphere @1.0",
            "numba-window-100mm R,K @1.0",
            "numba-paper-a-covered radii + conics, both faces of a lens alike",
            "numba-paper-a-covered bending + A4",
            "numba-paper-a-covered paraboloid, bending + A4",
        ),
    },
    "rendering/test_atlas.py": {
        "test_a_figure_shows_what_the_paper_says": (),
        "test_no_place_on_a_sheet_that_is_not_tilted_loses_the_piece": (),
        "test_bad_input_ends_with_status_2_and_one_sentence": (
            "arguments1-cannot read the scene",
            "arguments2-is a design, which has no camera",
            "arguments3-camera.frame",
            "arguments4-there is no preset",
            "arguments5-PHOTO",
        ),
        "test_render_writes_a_picture_says_how_and_refuses_to_overwrite": (),
        "test_the_atlas_is_made_in_any_folder": (),
        "test_render_of_a_movie_tells_each_frame_in_json": (),
        "test_an_eye_sees_a_photograph_before_and_after": (),
        "test_an_atlas_holds_figures_measurements_and_a_page_and_can_be_made_again": (),
        "test_the_forecast_of_an_atlas_grows_with_what_is_asked": (),
        "test_the_first_figure_s_section_and_solids_are_what_the_paper_says": (),
        "test_a_measured_row_fails_when_the_sheet_is_another": (),
    },
    "rendering/test_pov_differing.py": {
        "test_a_sheet_of_cells_that_differ_shows_the_rays_that_povray_finds": ("varying",),
    },
    "rendering/test_render.py": {
        "test_the_fitted_map_of_a_view_is_the_independent_tracer_s": ("z_k_2",),
        "test_the_homogeneous_sheet_shows_the_ideal_law": ("z_k_20",),
        "test_a_view_is_the_independent_renderer_s_picture": (),
        "test_a_picture_that_is_stopped_leaves_nothing_and_stops_at_once": (),
        "test_a_movie_is_written_as_mp4_where_the_encoder_is_installed": (),
        "test_a_movie_has_its_frames_in_order": (),
        "test_a_large_sheet_is_seen_in_the_memory_of_a_small_one": (),
        "test_compiled_and_plain_pictures_agree": (),
        "test_progress_tells_the_share_of_the_rays_that_are_done": (),
        "test_compiled_and_plain_code_see_the_same": (),
    },
    "rendering/test_render_pov.py": {
        "test_single_rays_have_the_colour_that_povray_finds": (),
        "test_every_form_of_sheet_shows_the_rays_that_povray_finds": (),
        "test_the_fitted_map_is_povray_s": (),
    },
    "rendering/test_render_scale.py": {
        "test_memory_does_not_grow_with_the_number_of_lenslets": (),
        "test_memory_beyond_the_picture_is_that_of_a_tile_however_large_the_picture": (),
        "test_an_opaque_surround_and_things_before_the_sheet_are_drawn_alike_by_all_ways": (),
        "test_the_kernel_that_does_all_gives_the_light_of_its_parts": (),
    },
    "report/test_notebook.py": {
        "test_html_is_well_formed_escapes_names_and_is_the_same_every_time": ("window-100mm",),
    },
    "report/test_report.py": {
        "test_progress_is_told_from_beginning_to_end": (),
    },
    "report/test_report_browser.py": {
        "test_the_part_turns_by_the_keyboard_and_starts_again": (),
        "test_without_webgl_there_is_a_picture_and_no_complaint": (),
        "test_the_part_is_drawn_and_turns_when_dragged": (),
        "test_a_cut_shows_the_inside": (),
        "test_text_can_be_read_in_light_and_dark": ("light",),
        "test_on_paper_the_picture_stands_for_the_view": (),
    },
    "report/test_report_of_strangers.py": {
        "test_a_stranger_s_name_steers_no_terminal_and_the_log_is_plain_lines": (),
    },
    "report/test_report_parts.py": {
        "test_the_picture_shows_every_body": ("plano",),
    },
    "sheet/test_plate.py": {
        "test_kept_cells_are_those_wholly_inside_by_brute_force": (),
        "test_points_level_with_corners_and_centres_are_decided_once": (),
    },
    "solid/test_brep_rims.py": {
        "test_the_web_that_a_refusal_names_holds_the_rim_and_less_leaves_an_overhang": (),
        "test_the_mesh_of_a_rimmed_biconic_is_closed_and_converges_to_the_solid": (),
        "test_a_rimmed_biconic_has_the_volume_of_the_true_surface": ("0.004-0.0",),
        "test_a_rim_with_a_throat_narrower_than_the_first_grid_stays_one_and_one_that_crosses_itself_is_refused": (),
        "test_rimmed_forms_are_valid_solids_in_memory_and_as_step_files_read_again": ("plano",),
    },
    "solid/test_brep_shells.py": {
        "test_rims_and_lands_lie_where_the_columns_of_the_sheet_have_them": (),
        "test_rims_lands_seams_and_outlines_give_valid_solids_as_many_as_are_counted": (
            "web",
            "seam and rim",
            "circle",
            "loose strips",
        ),
        "test_a_covered_body_is_one_valid_solid_with_the_volume_of_its_columns": (
            "flat",
            "tilted",
            "offset",
            "turned",
            "saddle lens",
            "cylinder",
            "micrometres",
        ),
        "test_cells_that_touch_the_outline_leave_no_sliver_of_land": (
            "one cell in its circle",
            "circle through lattice points",
        ),
        "test_saddles_and_crossings_are_those_of_the_cell_complex": (
            "square-euler0",
            "square-euler2",
            "hexagonal-euler1",
        ),
        "test_shipped_designs_of_every_form_are_built_as_valid_solids": (
            "galilean",
            "plano",
            "slab",
            "tilted",
            "tilted-seam",
        ),
        "test_steps_of_any_height_give_valid_solids": (
            "1e-09",
            "2.7144176165949066e-06",
            "0.0073680629972807735",
            "20.0",
        ),
    },
    "stacking/test_stack_files.py": {
        "test_a_stranger_reads_the_glb_with_every_sheet_where_it_stands": (),
    },
    "stacking/test_stack_light.py": {
        "test_facets_of_every_sheet_are_traced_in_a_row": (),
    },
    "storage/test_worker.py": {
        "test_a_kernel_that_hears_nothing_is_ended_without_its_answer": (),
        "test_real_kernels_that_want_more_than_1_5_gb_end_in_a_sentence": (),
        "test_a_hanging_child_is_ended_at_the_time_limit": (),
        "test_running_out_of_processor_time_names_the_limit": (),
        "test_running_out_of_memory_names_the_limit": (),
    },
    "test_duplicates.py": {
        "test_no_run_of_six_lines_stands_twice": (),
    },
    "topology/test_cannot_build.py": {
        "test_lenslets_that_disconnect_the_body_are_written_as_the_pieces_they_are": (),
        "test_a_sag_below_the_kernels_tolerance_is_an_exact_solid_and_no_mesh_where_float32_ends": (),
        "test_a_failure_of_one_format_leaves_the_others": (),
    },
    "tracing/test_facet_grid.py": {
        "test_rays_end_as_they_do_in_the_trees": (),
        "test_facets_that_are_no_whole_surface_are_met_as_in_the_trees": (),
        "test_rays_of_a_view_are_decided_without_the_trees": (),
    },
    "tracing/test_laws_of_sheets.py": {
        "test_moving_the_light_by_cells_moves_the_answer_by_cells": (),
        "test_facets_tend_to_the_surfaces_as_they_get_smaller": (),
        "test_the_mirrored_sheet_shows_the_mirrored_answer": (),
        "test_a_quarter_turn_of_everything_turns_the_answer": (),
        "test_every_ray_has_one_fate_and_only_invalid_rows_hold_nan": (),
        "test_a_change_of_unit_or_scale_changes_nothing": (),
        "test_one_cell_does_what_any_of_forty_thousand_does": (),
    },
    "tracing/test_light_sums.py": {
        "test_every_rung_is_summed": (
            "law",
            "thin",
        ),
    },
    "tracing/test_own_mesh.py": {
        "test_a_part_of_a_mesh_sends_light_through_its_cells_as_the_whole_does": (),
        "test_light_on_a_border_of_a_scaled_array_is_in_the_cell_that_rational_numbers_say": (),
        "test_light_through_triangles_of_two_bodies_goes_where_that_through_their_faces_does": (),
        "test_what_passes_array_2_beside_it_has_missed_the_sheet_and_comes_back_as_launched": (),
        "test_effects_change_light_through_triangles_as_those_of_equal_cells": (),
        "test_equal_cells_told_by_what_was_met_are_those_that_the_kernels_count": (),
    },
    "tracing/test_trace_embree.py": {
        "test_embree_and_the_own_tree_send_every_ray_the_same_way": (),
        "test_without_the_package_a_file_is_searched_by_the_tree_and_asking_for_embree_says_so": (),
    },
    "tracing/test_trace_fates.py": {
        "test_kernels_are_kept_on_disk_so_that_a_second_process_compiles_nothing": (),
        "test_a_small_verify_does_not_load_the_compiler": (),
    },
    "tracing/test_trace_kernels.py": {
        "test_single_precision_shows_the_same_light_to_a_microradian": (),
        "test_numpy_and_compiled_paths_give_every_ray_the_same_fate": (
            "paper base",
            "offset",
            "tilted by 20 degrees",
            "holes outside the rim",
            "web",
            "opaque seam",
            "hexagonal",
            "galilean",
            "round of cells",
            "baffle",
            "displaced slab",
            "round slab with seam",
            "plano outside",
            "plano inside, hexagonal",
        ),
    },
    "tracing/test_trace_mesh.py": {
        "test_every_ray_does_what_all_triangles_together_say": (),
        "test_facets_converge_at_first_order_and_vertex_normals_at_second": (),
        "test_triangles_from_anywhere_do_what_the_sheets_own_mesh_does": (),
        "test_fates_go_over_into_those_of_the_surfaces": (),
        "test_a_file_is_traced_like_the_mesh_it_was_written_from": (),
        "test_no_ray_is_lost_among_facets": (),
        "test_the_error_of_facets_is_what_their_slope_error_says": (),
        "test_the_sheets_own_mesh_is_traced_where_none_is_given_or_only_how_fine": (),
        "test_cells_written_as_touching_solids_pass_light_through_their_common_walls": (),
        "test_numpy_and_kernels_find_the_same_among_facets": (),
    },
    "tracing/test_trace_walk.py": {
        "test_the_walk_ends_where_a_march_in_small_steps_ends": ("offset",),
    },
    "tracing/test_tracer.py": {
        "test_a_mesh_is_laid_out_once_for_all_calls_and_again_for_other_normals": (),
        "test_a_window_and_all_that_was_laid_out_for_it_end_together": (),
        "test_a_file_of_triangles_is_read_once_until_it_changes": (),
    },
    "trust/attacks/test_odd_files.py": {
        "test_a_few_odd_values_in_a_manifest_are_answered": (),
        "test_out_of_handles_is_a_limit_said_in_one_sentence": (
            "check t.toml-5",
            "export t.toml -o out --format step -q-9",
        ),
    },
    "trust/attacks/test_odd_values.py": {
        "test_every_key_of_every_form_is_among_them": (),
    },
    "trust/test_command_line.py": {
        "test_json_is_all_there_is_on_stdout_and_the_log_is_json_on_stderr": (),
        "test_a_crash_of_the_kernel_is_70_in_one_sentence_and_the_other_files_are_written": (),
        "test_a_file_size_limit_is_4_whatever_file_meets_it": (),
        "test_a_mistake_of_our_own_is_70_and_v_tells_where": (),
        "test_a_kernel_without_memory_is_70_in_one_sentence_and_the_other_files_are_written": (),
        "test_a_format_that_the_design_cannot_have_is_said_and_the_others_are_written": (
            "baffle-plano-no baffle",
        ),
        "test_a_folder_that_cannot_be_one_is_4": ("/dev/null/out",),
        "test_too_many_lenslets_are_3_before_anything_is_loaded_that_could_build_or_trace_them": (
            "trace DESIGN RAYS -o OUT/o.npz-1e18",
        ),
        "test_a_full_disk_is_4_and_what_fits_is_published": (),
        "test_a_file_in_the_way_is_4_and_stays": (),
        "test_doctor_finds_this_installation_sound_and_leaves_no_file": (),
    },
    "trust/test_failing_writes.py": {
        "test_a_file_size_limit_is_raised_until_all_is_written": (),
        "test_a_small_disk_is_emptied_page_by_page_until_all_is_written": (),
    },
    "trust/test_foreign_folder.py": {
        "test_the_command_runs_no_module_of_the_folder_and_neither_do_its_children": (),
        "test_started_as_a_module_it_runs_none_either_but_what_python_takes_itself": (),
        "test_a_figure_is_drawn_by_no_settings_of_the_folder_or_the_user": (),
        "test_the_compiler_s_settings_in_the_folder_are_not_obeyed": (),
        "test_the_package_is_found_where_it_lies_in_the_current_folder_itself": (),
    },
    "trust/test_hostile.py": {
        "test_links_in_the_folder_are_not_followed_and_nothing_outside_is_touched": (),
        "test_mutated_step_text_is_scanned_or_refused": (),
    },
    "trust/test_interruptions.py": {
        "test_whatever_a_library_makes_of_an_interruption_it_is_one": ("another error",),
        "test_every_long_command_can_be_interrupted_and_leaves_nothing": ("accuracy",),
        "test_an_interrupted_export_is_130_and_leaves_nothing": ("2-stl-forecast",),
        "test_signals_at_any_instant_are_heard_or_come_too_late": (),
        "test_an_ignored_signal_stays_ignored": (),
        "test_a_second_signal_does_not_break_off_the_cleaning_up": (),
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
        "test_a_lenslet_in_a_wrong_place_is_caught": (),
        "test_a_changed_solid_is_caught_with_a_manifest_that_vouches_for_it": (),
    },
    "trust/test_mutations_of_maps.py": {
        "test_a_changed_number_is_caught_with_a_manifest_that_vouches_for_it_and_without_any": (
            "calibration: its step",
        ),
        "test_unchanged_ones_pass_with_a_manifest_and_without": ("tiny.sheet-back.mask.svg",),
        "test_changed_layers_are_caught": (),
    },
    "trust/test_races.py": {
        "test_a_clock_that_goes_backwards_changes_nothing": (),
        "test_who_reads_while_an_export_writes_is_told_so": (),
    },
    "trust/test_reading_budgets.py": {
        "test_a_grey_mask_on_which_its_library_crashes_fails_its_checks": (),
    },
    "trust/test_soak.py": {
        "test_a_random_design_is_exported_and_verified": (),
    },
    "trust/test_streams_and_places.py": {
        "test_what_is_printed_into_a_closed_stream_ends_up_in_no_file": (),
        "test_nobody_s_home_is_needed": (),
        "test_a_stream_that_lacks_letters_changes_no_status": (),
        "test_where_no_compiled_kernel_can_be_kept_the_work_is_done_and_that_is_said_once": (),
        "test_a_full_disk_behind_the_output_is_4_in_one_sentence": (),
        "test_a_closed_stream_changes_no_status": ("<&- >&- 2>&-",),
    },
    "trust/test_verdict_of_meshes.py": {
        "test_the_bench_s_own_triangles_grow_into_its_own_faces": (),
        "test_a_mesh_is_a_master_where_light_through_its_triangles_keeps_the_limits": (),
        "test_a_step_file_of_a_design_that_passes_is_a_master": (),
        "test_the_bench_s_own_tracer_finds_what_was_measured_before_it": (),
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
        "test_the_bytes_are_those_recorded_for_these_versions": (),
    },
    "verification/test_accuracy.py": {
        "test_every_form_is_held_to_fifty_digits_and_to_its_step_file": (
            "slab",
            "hexagonal",
            "plano",
            "galilean",
        ),
        "test_rays_go_to_the_step_file_until_a_thousand_came_through_and_none_goes_twice": (),
        "test_the_table_is_json_and_the_plot_is_the_same_for_the_same_table": (),
        "test_facets_are_of_first_order_and_vertex_normals_of_second": (),
        "test_every_rung_stands_beside_its_error_and_its_seconds": (),
        "test_the_measured_errors_are_those_known_of_the_papers_sheet": (),
        "test_step_as_the_kernel_reads_it_sends_light_where_the_surfaces_do": (),
        "test_a_target_names_the_cheapest_setting_that_meets_it": (),
        "test_no_row_beats_a_row_of_the_front_in_both": (),
        "test_every_export_format_has_its_floor": (),
        "test_the_floor_of_each_format_is_confirmed_by_a_trace": (),
        "test_single_precision_is_a_tenth_of_a_microradian_not_a_milliradian": (),
    },
    "verification/test_aimed_files.py": {
        "test_light_finds_out_a_sheet_that_was_made_otherwise": (),
        "test_a_step_file_of_cells_that_differ_is_a_master_and_says_of_how_many": (),
    },
    "verification/test_cluster.py": {
        "test_what_was_delivered_before_the_workers_were_lost_is_kept_and_said": (),
    },
    "verification/test_differing_studies.py": {
        "test_rows_of_the_sheet_itself_are_measured_on_the_rays_given": (),
    },
    "verification/test_field_lens_files.py": {
        "test_two_plates_are_written_and_judged_as_masters": (),
    },
    "verification/test_file_light.py": {
        "test_the_shift_that_was_made_is_the_shift_that_is_found": ("-0.01-slab",),
        "test_a_bare_scan_of_the_middle_cell_is_lit_there": (),
        "test_light_through_a_map_is_that_of_the_exact_faces": (
            "*back.u16.tiff",
            "*front.u16.png",
            "*back.xyz",
            "*front.cell.dat",
        ),
    },
    "verification/test_mesh_instances.py": {
        "test_a_sheet_of_40_000_cells_is_read_and_judged_without_expanding_it": (),
        "test_noise_of_a_tenth_of_a_micrometre_fails_where_the_honest_file_passes": ("8",),
        "test_wrong_stored_normals_fail": (),
        "test_stored_normals_are_judged_by_their_angle_to_the_sphere": (),
        "test_errors_that_a_manifest_states_too_large_widen_no_limit": (),
        "test_a_survey_of_40_000_cells_has_their_box_and_the_corners_of_their_hull_however_they_lie": (),
        "test_a_repeated_cell_gets_the_verdict_of_all_cells_written_out": ("plano-glb",),
        "test_a_cell_open_by_itself_fails_at_40_000_places": (),
        "test_pieces_of_a_large_file_are_counted_or_the_sentence_says_that_they_are_not": (),
        "test_a_hexagonal_sheet_of_repeated_cells_stands_on_its_lattice": (),
        "test_one_instance_in_a_wrong_place_fails_placement": ("3mf-beside the sheet",),
    },
    "verification/test_registration.py": {
        "test_a_scan_goes_through": (),
        "test_wrong_parts_are_named": (),
        "test_the_deviation_map_is_a_picture_and_a_table": (),
        "test_the_pose_is_found_and_undone": ("as written",),
        "test_a_tilt_of_the_wrong_sign_is_named": (),
        "test_a_radius_one_percent_off_is_caught": (),
        "test_shrinkage_is_found_as_a_scale_and_judged": (),
        "test_a_mirrored_part_fails_handedness": (),
    },
    "verification/test_returned_parts.py": {
        "test_a_copy_of_an_exported_mesh_lies_as_it_was_written": (),
        "test_a_part_turned_about_an_oblique_axis_is_found_and_judged_right": (),
        "test_a_disc_turned_about_its_normal_is_found_by_its_lenses": (),
        "test_a_piece_sawn_askew_is_found_by_its_lenses": (),
        "test_dents_are_listed_with_depth_place_and_cell_face_by_face": (),
        "test_a_turned_mirror_image_is_still_told": (),
        "test_a_turned_part_is_found_in_any_unit": (),
        "test_a_drilled_piece_is_recognised_and_its_hole_named": ("as it lay",),
        "test_a_good_part_does_not_fail_shape_by_where_it_lies": ("plano-turned a quarter",),
        "test_a_mesh_that_lacks_one_facet_is_broken_and_no_scan": (),
        "test_faces_alone_are_a_scan": (),
        "test_the_picture_of_deviations_has_units_on_every_axis": (),
        "test_a_shrink_beyond_the_limit_fails_scale_alone": (),
    },
    "verification/test_step_strangers.py": {
        "test_a_piece_with_a_drilled_hole_is_recognised_and_the_hole_is_named": (),
        "test_one_row_of_instances_off_the_lattice_is_named_with_its_cell_and_distance": (),
        "test_lens_faces_that_another_program_fitted_closely_pass_by_their_light": (),
        "test_one_body_moved_by_a_two_hundredth_of_the_separation_fails": (),
        "test_a_cell_left_out_and_a_cell_put_twice_are_named": (),
        "test_a_part_a_thousandth_too_small_fails": (),
        "test_a_kernel_s_own_file_gets_the_same_rows": (),
        "test_lens_faces_that_another_program_fitted_badly_fail": (),
        "test_a_good_part_written_again_passes_as_an_optical_master_in_any_unit_and_structure": (
            "INCH-one-assembly",
        ),
        "test_light_through_the_patches_of_the_text_goes_where_the_kernel_sends_it": (),
        "test_lenses_whose_radius_is_off_by_a_hundredth_fail": (),
    },
    "verification/test_sweep.py": {
        "test_the_command_writes_the_table_and_prints_it": (),
        "test_the_tolerance_command_prints_contributors_and_yield": (),
    },
    "verification/test_tolerance.py": {
        "test_a_study_is_written_and_read_back_with_the_same_bytes_every_time": (),
        "test_two_processes_find_what_one_finds": (),
        "test_more_samples_go_on_from_a_checkpoint": (),
    },
    "verification/test_verify_files.py": {
        "test_a_file_of_another_design_fails_by_name": (),
        "test_a_spoilt_file_fails_by_name": ("empty",),
        "test_a_role_is_declared_for_a_format_or_a_file_and_for_nothing_else": (),
        "test_the_same_files_give_the_same_json": (),
        "test_fewer_cells_than_designed_are_found": (),
        "test_a_preview_of_a_manifest_counts_as_declared_only_where_it_was": (),
        "test_a_coarse_file_declared_as_a_preview_is_accepted_as_a_shape": (),
        "test_one_body_of_two_is_judged_against_that_body": (),
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


BY_HAND: dict[str, dict[str, tuple[str, ...]]] = {
    "cli/test_commands_agree.py": {
        "test_check_and_verify_of_a_design_end_alike_and_fail_the_same_checks": (
            "plano",
            "slab",
            "tilted-seam",
        ),
    },
    "exporting/test_default_exports.py": {
        "test_a_default_export_in_every_format_passes_its_own_verification": ("slab", "hexagonal"),
    },
    "rendering/test_atlas.py": {
        "test_a_figure_shows_what_the_paper_says": ("F3", "F4", "F6", "F7", "F8"),
    },
}
"""By file and test the slow cases that continuous integration runs; the others run with `-m long`, by hand."""


@dataclass(frozen=True)
class Sorted:
    """Which cases do not run by default.

    Attributes
    ----------
    slow, by_hand : list of int
        Places among the cases given.
    unknown : list of str
        Of tests that have cases here, those that are named above and are not among the cases given.
    """

    slow: list[int]
    by_hand: list[int]
    unknown: list[str]


def sort_out(cases: Iterable[tuple[str, str, str]]) -> Sorted:
    """Say which cases are slow, which run by hand alone, and which names above are of no case.

    Parameters
    ----------
    cases : iterable of (file below tests/, test, case)
    """
    rows = list(cases)
    there = defaultdict(set)
    for file, test, case in rows:
        there[file, test].add(case)

    def left_out(table: dict[str, dict[str, tuple[str, ...]]]) -> list[int]:
        return [
            place
            for place, (file, test, case) in enumerate(rows)
            if case not in table.get(file, {}).get(test, (case,))
        ]

    unknown = [
        f"{file}::{test}[{case}]"
        for table in (EVERY_TIME, BY_HAND)
        for file, test in there
        for case in table.get(file, {}).get(test, ())
        if case not in there[file, test]
    ]
    return Sorted(slow=left_out(EVERY_TIME), by_hand=left_out(BY_HAND), unknown=unknown)
