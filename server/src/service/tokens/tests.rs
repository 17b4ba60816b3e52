use super::changing::PREFIX;
use super::*;
use crate::clock::SECOND_NS;
use crate::role::{Ability, Reach, Role};

async fn tokens(directory: &std::path::Path) -> Tokens {
    Tokens::load(&Storage::open(directory).await.unwrap()).await.unwrap()
}

fn is_unauthenticated(admitted: &Result<Admitted, ServiceError>) -> bool {
    matches!(admitted, Err(ServiceError::Unauthenticated { .. }))
}

#[tokio::test]
async fn roles_open_what_they_are_for() {
    let directory = tempfile::tempdir().unwrap();
    let tokens = tokens(directory.path()).await;
    let before = tokens.admit(None, None, Access::Server).unwrap();
    let (_, admin) = tokens.create(NewToken::of("operator", Role::Admin)).await.unwrap();
    assert!(before.ending.over().is_cancelled(), "what was let in without a token must end");
    let (_, robot) = tokens.create(NewToken::of("robot", Role::Robot)).await.unwrap();
    for access in [Access::STREAM, Access::Server] {
        assert!(is_unauthenticated(&tokens.admit(None, None, access)));
        assert!(is_unauthenticated(&tokens.admit(None, Some(""), access)));
        assert!(is_unauthenticated(&tokens.admit(None, Some(&robot[..robot.len() - 1]), access)));
        assert!(tokens.admit(None, Some(&admin), access).is_ok());
    }
    assert!(tokens.admit(None, None, Access::Open).is_ok());
    assert!(tokens.admit(None, Some(&robot), Access::STREAM).is_ok());
    let denied = tokens.admit(None, Some(&robot), Access::Server);
    assert!(matches!(denied, Err(ServiceError::PermissionDenied { .. })), "{denied:?}");
    tokens.storage.close().await;
}

#[tokio::test]
async fn a_token_outlives_the_server_and_only_its_hash_is_stored() {
    let directory = tempfile::tempdir().unwrap();
    let first = tokens(directory.path()).await;
    let (_, secret) = first.create(NewToken::of("operator", Role::Admin)).await.unwrap();
    first.storage.close().await;
    drop(first);
    assert!(secret.starts_with(PREFIX) && secret.len() == PREFIX.len() + 64, "{secret}");
    let file = std::fs::read(directory.path().join("waypost.sqlite")).unwrap();
    let holds = |bytes: &[u8]| file.windows(bytes.len()).any(|window| window == bytes);
    assert!(holds(&hash(&secret)) && !holds(&secret.as_bytes()[PREFIX.len()..]));
    let second = tokens(directory.path()).await;
    let admitted = second.admit(None, Some(&secret), Access::Server).unwrap();
    second.delete("tokens/operator").await.unwrap();
    assert!(admitted.ending.over().is_cancelled());
    assert!(second.admit(None, None, Access::Server).is_ok(), "with no token left, everyone is served again");
    second.storage.close().await;
}

#[tokio::test]
async fn nobody_is_locked_out_and_no_door_is_left_open() {
    let directory = tempfile::tempdir().unwrap();
    let tokens = tokens(directory.path()).await;
    let refused = |result: Result<(), ServiceError>| match result {
        Err(ServiceError::FailedPrecondition { message }) => message,
        other => panic!("{other:?}"),
    };
    let first_robot = tokens.create(NewToken::of("robot", Role::Robot)).await.map(drop);
    assert!(refused(first_robot).contains("the first token must be an admin's"));
    tokens.create(NewToken::of("operator", Role::Admin)).await.unwrap();
    tokens.create(NewToken::of("robot", Role::Robot)).await.unwrap();
    let exists = tokens.create(NewToken::of("robot", Role::Robot)).await;
    assert!(matches!(exists, Err(ServiceError::AlreadyExists { .. })), "{exists:?}");
    let last_admin = tokens.delete("tokens/operator").await;
    assert!(refused(last_admin).contains("create another admin token first"));
    tokens.delete("tokens/robot").await.unwrap();
    tokens.set_anonymous(Anonymous::Refused);
    let last = tokens.delete("tokens/operator").await;
    assert!(refused(last).contains("the last token"));
    let missing = tokens.delete("tokens/nobody").await;
    assert!(matches!(missing, Err(ServiceError::NotFound { .. })), "{missing:?}");
    tokens.storage.close().await;
}

#[tokio::test]
async fn lists_go_by_name_in_pages() {
    let directory = tempfile::tempdir().unwrap();
    let tokens = tokens(directory.path()).await;
    for name in ["c", "a", "b"] {
        tokens.create(NewToken::of(name, Role::Admin)).await.unwrap();
    }
    let names = |page: &Page<TokenRow>| {
        page.items.iter().map(|token| token.name.clone()).collect::<Vec<_>>().join(" ")
    };
    let first = tokens.list(2, "").unwrap();
    assert_eq!((names(&first).as_str(), first.next.as_str()), ("a b", page_after("b").as_str()));
    let second = tokens.list(2, &first.next).unwrap();
    assert_eq!((names(&second).as_str(), second.next.as_str()), ("c", ""));
    assert!(tokens.list(2, "no/token").is_err());
    tokens.storage.close().await;
}

fn limited(name: &str, role: Role, maps: &[&str]) -> NewToken {
    NewToken { maps: maps.iter().map(|&map| map.to_owned()).collect(), ..NewToken::of(name, role) }
}

fn message(error: &ServiceError) -> String {
    error.to_string()
}

#[tokio::test]
async fn a_reader_and_a_limited_robot_are_let_in_to_what_they_may_do() {
    let directory = tempfile::tempdir().unwrap();
    let tokens = tokens(directory.path()).await;
    tokens.create(NewToken::of("operator", Role::Admin)).await.unwrap();
    let (_, reader) = tokens.create(NewToken::of("prometheus", Role::Reader)).await.unwrap();
    let looking = NewToken { abilities: vec![Ability::Localize], ..NewToken::of("scout", Role::Robot) };
    let (_, scout) = tokens.create(looking).await.unwrap();
    let all =
        [Access::READ, Access::LOCALIZE, Access::STREAM, Access::NAVIGATE, Access::ADMIN, Access::Server];
    let may = |secret: &str| all.map(|access| tokens.admit(None, Some(secret), access).is_ok());
    assert_eq!(may(&reader), [true, false, false, false, false, false]);
    assert_eq!(may(&scout), [false, true, false, false, false, false]);
    assert!(tokens.admit(None, Some(&scout), Access::OPEN_SESSION).is_ok());
    assert!(tokens.admit(None, Some(&reader), Access::Token).is_ok());
    let refused = message(&tokens.admit(None, Some(&reader), Access::OPEN_SESSION).unwrap_err());
    assert_eq!(
        refused,
        "this takes a token that may localize or stream, and prometheus may only read; ask who runs the server for one \
         that may"
    );
    tokens.storage.close().await;
}

#[tokio::test]
async fn a_token_for_some_maps_reaches_no_other_and_not_the_whole_server() {
    let directory = tempfile::tempdir().unwrap();
    let tokens = tokens(directory.path()).await;
    tokens.create(NewToken::of("operator", Role::Admin)).await.unwrap();
    let (_, secret) = tokens.create(limited("floor2", Role::Admin, &["floor2-*", "hall"])).await.unwrap();
    let caller = tokens.admit(None, Some(&secret), Access::ADMIN).unwrap().caller;
    for name in ["maps/hall", "maps/floor2-east/sessions/a", "models/hall", "maps/NO NAME"] {
        assert_eq!(caller.check_resource(name), Ok(()), "{name}");
    }
    let refused = message(&caller.check_resource("maps/attic/places/7").unwrap_err());
    assert!(
        refused.starts_with(
            "the token floor2 is for the maps floor2-* and hall, and not for the map attic; ask"
        )
    );
    let whole = message(&tokens.admit(None, Some(&secret), Access::Server).unwrap_err());
    assert!(whole.contains("about the whole server, and the token floor2 is for"), "{whole}");
    // Limits are as good after a restart.
    let loaded = Tokens::load(&tokens.storage).await.unwrap();
    assert_eq!(loaded.all(), tokens.all());
    assert_eq!(loaded.admit(None, Some(&secret), Access::ADMIN).unwrap().caller.reach, caller.reach);
    tokens.storage.close().await;
}

#[tokio::test]
async fn what_expires_is_refused_and_ends() {
    let directory = tempfile::tempdir().unwrap();
    let tokens = tokens(directory.path()).await;
    tokens.create(NewToken::of("operator", Role::Admin)).await.unwrap();
    let guest = NewToken { lifetime_s: Some(60), ..NewToken::of("guest", Role::Robot) };
    let (row, secret) = tokens.create(guest).await.unwrap();
    let expires_ns = row.expires_ns.unwrap();
    assert_eq!(expires_ns - row.created_ns, 60 * SECOND_NS);
    let admitted = tokens.admit(None, Some(&secret), Access::STREAM).unwrap();
    assert_eq!(admitted.caller.expires_ns, Some(expires_ns));
    assert_eq!(tokens.lock().end_what_is_over(expires_ns - 1), Some(expires_ns));
    assert!(!admitted.ending.over().is_cancelled());
    assert_eq!(tokens.lock().end_what_is_over(expires_ns), None);
    assert!(admitted.ending.over().is_cancelled());
    let why = message(&admitted.ending.why());
    assert!(why.starts_with("the token guest expired at 2") && why.contains("token rotate guest"), "{why}");
    let refused = tokens.lock().secret(&hash(&secret)).unwrap().check_time(expires_ns).unwrap_err();
    assert_eq!(refused, admitted.ending.why());
    // With more time, the secret before is good again, and what is begun with it goes on.
    let longer = Rotation { overlap_s: Some(10), lifetime_s: Some(3600) };
    tokens.rotate("tokens/guest", longer).await.unwrap();
    assert!(!tokens.admit(None, Some(&secret), Access::STREAM).unwrap().ending.over().is_cancelled());
    tokens.storage.close().await;
}

#[tokio::test]
async fn a_rotated_token_has_two_secrets_for_a_while_and_never_three() {
    let directory = tempfile::tempdir().unwrap();
    let tokens = tokens(directory.path()).await;
    let (_, first) = tokens.create(NewToken::of("operator", Role::Admin)).await.unwrap();
    let by_first = tokens.admit(None, Some(&first), Access::Server).unwrap();
    let (row, second) = tokens.rotate("tokens/operator", Rotation::default()).await.unwrap();
    let until_ns = row.former.unwrap().until_ns;
    let left_s = (until_ns - now_ns()) as f64 / SECOND_NS as f64;
    assert!((3590.0..=3600.0).contains(&left_s), "{left_s}");
    let by_second = tokens.admit(None, Some(&second), Access::Server).unwrap();
    assert_eq!((by_second.caller.expires_ns, by_second.caller.token.as_deref()), (None, Some("operator")));
    let again = tokens.admit(None, Some(&first), Access::Server).unwrap();
    assert_eq!(again.caller.expires_ns, Some(until_ns));
    // As after a restart.
    let loaded = Tokens::load(&tokens.storage).await.unwrap();
    assert!([&first, &second].iter().all(|secret| loaded.admit(None, Some(secret), Access::Server).is_ok()));

    assert_eq!(tokens.lock().end_what_is_over(until_ns), None);
    assert!(by_first.ending.over().is_cancelled() && !by_second.ending.over().is_cancelled());
    let why = message(&by_first.ending.why());
    assert!(why.contains("operator has a new secret, and this one was good until 2"), "{why}");

    let at_once = Rotation { overlap_s: Some(0), lifetime_s: None };
    let (_, third) = tokens.rotate("tokens/operator", at_once).await.unwrap();
    assert!(is_unauthenticated(&tokens.admit(None, Some(&first), Access::Server)));
    let replaced = tokens.admit(None, Some(&second), Access::Server).map(drop).unwrap_err();
    assert!(message(&replaced).contains("use the new one"));
    assert!(tokens.admit(None, Some(&third), Access::Server).is_ok());
    tokens.delete("tokens/operator").await.unwrap();
    assert!(tokens.is_empty());
    tokens.storage.close().await;
}

#[tokio::test]
async fn one_token_always_administers_the_server_for_good() {
    let directory = tempfile::tempdir().unwrap();
    let tokens = tokens(directory.path()).await;
    let passing = NewToken { lifetime_s: Some(60), ..NewToken::of("operator", Role::Admin) };
    for not_first in
        [passing, limited("operator", Role::Admin, &["hall"]), NewToken::of("operator", Role::Reader)]
    {
        let refused = message(&tokens.create(not_first).await.map(drop).unwrap_err());
        assert!(refused.contains("the first token must be an admin's"), "{refused}");
    }
    tokens.create(NewToken::of("operator", Role::Admin)).await.unwrap();
    tokens.create(limited("floor2", Role::Admin, &["floor2-*"])).await.unwrap();
    let mortal = tokens.rotate("tokens/operator", Rotation { overlap_s: None, lifetime_s: Some(60) }).await;
    for refused in [mortal.map(drop), tokens.delete("tokens/operator").await] {
        let refused = message(&refused.unwrap_err());
        assert!(refused.contains("create another admin token first"), "{refused}");
    }
    tokens.storage.close().await;
}

#[tokio::test]
async fn limits_that_cannot_be_meant_are_refused() {
    let directory = tempfile::tempdir().unwrap();
    let tokens = tokens(directory.path()).await;
    tokens.create(NewToken::of("operator", Role::Admin)).await.unwrap();
    let robot = || NewToken::of("robot", Role::Robot);
    let may = |role, abilities: &[Ability]| NewToken {
        abilities: abilities.to_vec(),
        ..NewToken::of("robot", role)
    };
    let many: Vec<String> = (0..65).map(|number| format!("map-{number}")).collect();
    for (case, new, says) in [
        (
            "beyond a reader",
            may(Role::Reader, &[Ability::Read, Ability::Stream]),
            "a reader may read, and not stream",
        ),
        ("beyond a robot", may(Role::Robot, &[Ability::Admin]), "and not admin; leave that out"),
        ("less than an admin", may(Role::Admin, &[Ability::Read]), "choose the role robot or reader"),
        ("nothing", limited("robot", Role::Robot, &[""]), "leave them out for all maps"),
        ("everything", limited("robot", Role::Robot, &["*"]), "leave them out for all maps"),
        ("an asterisk within", limited("robot", Role::Robot, &["floor*east"]), "is no map name"),
        ("a name with a comma", limited("robot", Role::Robot, &["hall,attic"]), "is no map name"),
        ("a full name", limited("robot", Role::Robot, &["maps/hall"]), "is no map name"),
        ("too many", NewToken { maps: many, ..robot() }, "at most 64 maps, not 65"),
        ("no time at all", NewToken { lifetime_s: Some(0), ..robot() }, "say at least 1 s"),
    ] {
        let refused = tokens.create(new).await.map(drop).unwrap_err();
        assert!(matches!(refused, ServiceError::InvalidArgument { .. }), "{case}: {refused:?}");
        assert!(message(&refused).contains(says), "{case}: {refused}");
    }
    let robots = [Ability::Stream, Ability::Navigate, Ability::Read, Ability::Localize, Ability::Read];
    let (all, _) = tokens.create(may(Role::Robot, &robots)).await.unwrap();
    assert_eq!((all.abilities, all.reach), (Role::Robot.abilities(), Reach::Everywhere));
    for (rotation, says) in [
        (Rotation { overlap_s: Some(604_801), lifetime_s: None }, "at most 604800 s (a week), not 604801"),
        (Rotation { overlap_s: None, lifetime_s: Some(0) }, "say at least 1 s"),
    ] {
        let refused = message(&tokens.rotate("tokens/robot", rotation).await.map(drop).unwrap_err());
        assert!(refused.contains(says), "{refused}");
    }
    let missing = tokens.rotate("tokens/nobody", Rotation::default()).await.map(drop);
    assert!(matches!(missing, Err(ServiceError::NotFound { .. })), "{missing:?}");
    tokens.storage.close().await;
}
