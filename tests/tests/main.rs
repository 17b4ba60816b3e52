//! Waypost from the outside: real servers on ports of their own, the real client, real images.
#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a test fails by panicking")]

mod harness;

/// What the repository promises of itself: who imports whom, and under which licences.
mod house {
    mod architecture;
    mod dependencies;
    mod licences;
}

/// Servers over one database of PostgreSQL.
mod fleet {
    mod any_server;
    mod full_disk;
    mod handing_over;
    mod helping;
    mod jobs;
    mod lease_model;
    mod media;
    mod migrating;
    mod owners;
    mod standbys;
    mod told;
}

/// Maps of other programs, and what they were made with.
mod imports {
    mod rtabmap;
    mod vocabularies;
}

/// Maps: what they keep, how they are told, restored, moved and explained.
mod maps {
    mod bad_requests;
    mod checkpoints;
    mod corrections;
    mod explain;
    mod jobs;
    mod jobs_that_go_on;
    mod mapping;
    mod matrix;
    mod notes;
    mod odometry_agreement;
    mod pictures;
    mod places;
    mod queries;
    mod rebind;
    mod restore;
    mod snapshots;
    mod structure;
    mod training;
}

/// Maps that become one, and what is taken out of them again.
mod merging {
    mod compaction;
    mod rebuilding;
    mod refusals;
    mod rounds;
    mod whole_maps;
}

/// Robots that are led, by metres and by looks.
mod navigation {
    mod appearance_links;
    mod appearance_mirror;
    mod appearance_navigation;
    mod appearance_ways;
    mod clocks;
    mod goals;
    mod metric;
    mod simulated;
}

/// What an operator relies on: settings, limits, access, crashes, full disks.
mod operations {
    mod abuse;
    mod backups;
    mod command_line;
    mod config;
    mod connections;
    mod datasets;
    mod disk;
    mod disk_full;
    mod first_minute;
    mod held_up;
    mod kill;
    mod long_runs;
    mod mistakes;
    mod model;
    mod operating;
    mod photographs;
    mod refusals;
    mod refused_commands;
    mod rot;
    mod shutdown;
    mod soak;
    mod startup;
    mod tls;
    mod tokens;
    mod videos;
}

/// REST beside gRPC, and bad values in every field of either.
mod rest {
    mod bad_table;
    mod cross_origin;
    mod errors_and_pages;
    mod exports;
    mod openapi;
    mod parity;
    mod writes;
}

/// Robots that stream frames: what they are told, and what they get wrong.
mod robots {
    mod bad_frames;
    mod bad_sessions;
    mod decisions;
    mod events;
    mod frames;
    mod golden;
    mod load;
    mod localize;
    mod overload;
    mod resend;
    mod verification;
    mod words;
}
