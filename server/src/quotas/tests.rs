use std::num::NonZeroU32;

use super::*;

const MIB: u64 = 1 << 20;

fn sessions(sessions: u64) -> Used {
    Used { sessions, ..Used::default() }
}

fn kept(kept_bytes: u64) -> Used {
    Used { kept_bytes, ..Used::default() }
}

fn refused<T: std::fmt::Debug>(result: Result<T, OverQuota>) -> OverQuota {
    result.unwrap_err()
}

#[test]
fn nothing_is_limited_unless_it_is_asked_for() {
    let quotas = Quotas::default();
    quotas.add(Some("robot"), Used { maps: 1000, sessions: 1000, kept_bytes: u64::MAX / 4 });
    for owner in [None, Some("robot"), Some("other")] {
        assert_eq!((quotas.check_map(owner), quotas.check_session(owner)), (Ok(()), Ok(())));
        assert!(quotas.reserve(owner, MIB).is_ok());
        for _ in 0..10_000 {
            quotas.frame(owner, Some(1), Instant::now()).unwrap().spend();
        }
    }
}

#[test]
fn a_token_is_refused_what_is_above_its_own_quotas_and_others_are_not() {
    let quotas = Quotas::default();
    let limits = Limits { maps: Some(1), sessions: Some(3), kept_mib: Some(2), ..Limits::default() };
    quotas.set_token("robot", &limits);
    quotas.add(Some("robot"), sessions(2));
    assert_eq!(quotas.check_session(Some("robot")), Ok(()));
    quotas.add(Some("robot"), sessions(1));
    let over = refused(quotas.check_session(Some("robot")));
    assert_eq!(
        over.message,
        "the token robot has 3 of the 3 sessions that it may (max_sessions); go on with one of them by its name, delete one \
         (waypost session rm), or ask who runs the server for more (waypost token limit robot --max-sessions 4)"
    );
    assert_eq!(over.retry_after, None, "it is of no use to ask again");
    quotas.add(Some("robot"), Used { maps: 1, ..Used::default() });
    assert!(
        refused(quotas.check_map(Some("robot")))
            .message
            .contains("has 1 of the 1 maps that it may (max_maps)")
    );

    quotas.add(Some("robot"), kept(2 * MIB));
    let over = refused(quotas.check_room(Some("robot")));
    assert!(
        over.message.contains("has 2.0 of the 2 MiB in its sessions that it may (max_kept_mib)"),
        "{over}"
    );
    assert!(over.message.ends_with("this frame may be sent again in 5 s"), "{over}");
    assert_eq!(over.retry_after, Some(ROOM_RETRY));
    for other in [None, Some("other")] {
        assert_eq!((quotas.check_session(other), quotas.check_map(other)), (Ok(()), Ok(())));
        assert_eq!(quotas.check_room(other), Ok(()));
    }
    // Lifted, and what was counted anew.
    quotas.set_token("robot", &Limits { sessions: Some(4), ..Limits::default() });
    assert_eq!((quotas.check_session(Some("robot")), quotas.check_map(Some("robot"))), (Ok(()), Ok(())));
    quotas.set_token("robot", &limits);
    quotas.recount(UsedByOwner::from([(None, sessions(9)), (Some("robot".to_owned()), sessions(1))]));
    assert_eq!((quotas.check_session(Some("robot")), quotas.used_by("robot")), (Ok(()), sessions(1)));
}

#[test]
fn what_is_on_its_way_counts_until_it_is_there() {
    let quotas = Quotas::default();
    quotas.set_token("robot", &Limits { kept_mib: Some(3), ..Limits::default() });
    let first = quotas.reserve(Some("robot"), MIB).unwrap();
    let second = quotas.reserve(Some("robot"), 2 * MIB).unwrap();
    assert!(refused(quotas.reserve(Some("robot"), 1)).retry_after.is_some());
    assert!(quotas.check_session(Some("robot")).is_err(), "a session keeps something, too");
    // One is stored, and one was refused after all.
    quotas.add(Some("robot"), kept(MIB));
    drop((first, second));
    assert_eq!(quotas.used_by("robot"), kept(MIB));
    assert!(quotas.reserve(Some("robot"), 2 * MIB).is_ok());
    assert!(quotas.reserve(Some("robot"), 2 * MIB + 1).is_err());
}

#[test]
fn the_server_counts_all_whosever_it_is_and_names_its_settings() {
    let quotas = Quotas::default();
    let two = NonZeroU32::new(2);
    quotas.set_server(ServerLimits { max_maps: two, max_sessions: two, max_kept_mib: two });
    assert_eq!(quotas.check_copies(2, 2 * MIB), Ok(()));
    assert!(quotas.check_copies(3, 0).is_err() && quotas.check_copies(0, 2 * MIB + 1).is_err());
    for owner in [None, Some("robot")] {
        quotas.add(owner, Used { maps: 1, sessions: 1, kept_bytes: MIB });
    }
    let refusals = [
        (refused(quotas.check_map(None)), "2 of the 2 maps", "max_maps", "--max-maps 3"),
        (
            refused(quotas.check_session(Some("other"))),
            "2 of the 2 sessions",
            "max_sessions",
            "--max-sessions 3",
        ),
        (refused(quotas.check_room(Some("robot"))), "2.0 of the 2 MiB", "max_kept_mib", "--max-kept-mib 4"),
    ];
    for (over, used, setting, flag) in refusals {
        assert!(over.message.contains(&format!("the server has {used}")), "{over}");
        assert!(over.message.contains(&format!("({setting})")) && over.message.contains(flag), "{over}");
    }
    let (used, refusals) = quotas.in_all();
    assert_eq!(used, Used { maps: 2, sessions: 2, kept_bytes: 2 * MIB });
    let of_server = |quota| refusals.get(&(quota, Holder::Server)).copied();
    let counted = [Quota::Maps, Quota::Sessions, Quota::Kept].map(of_server);
    assert_eq!((counted, refusals.len()), ([Some(1), Some(2), Some(2)], 3));
}

#[test]
fn frames_a_second_are_of_the_token_whatever_the_stream() {
    let quotas = Quotas::default();
    quotas.set_token("robot", &Limits { frames_per_second: Some(2.0), ..Limits::default() });
    let now = Instant::now();
    quotas.frame(Some("robot"), Some(1), now).unwrap().spend();
    // One that was not looked at is given back.
    drop(quotas.frame(Some("robot"), Some(2), now).unwrap());
    quotas.frame(Some("robot"), Some(2), now).unwrap().spend();
    let over = refused(quotas.frame(Some("robot"), Some(1), now));
    assert!(over.message.contains("the token robot has sent the 2 frames a second that it may"), "{over}");
    let wait = over.retry_after.unwrap();
    assert!(over.message.contains("send this one again in 0.5 s"), "{over}");
    quotas.frame(Some("robot"), Some(1), now + wait).unwrap().spend();
    // Lifted, it holds at once.
    quotas.set_token("robot", &Limits::default());
    for _ in 0..100 {
        quotas.frame(Some("robot"), Some(1), now + wait).unwrap().spend();
    }
}
