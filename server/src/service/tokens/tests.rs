use super::*;

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
    let before = tokens.admit(None, None, Access::Admin).unwrap();
    let (_, admin) = tokens.create("operator", Role::Admin).await.unwrap();
    assert!(before.deleted.is_cancelled(), "what was let in without a token must end");
    let (_, robot) = tokens.create("robot", Role::Robot).await.unwrap();
    for access in [Access::Robot, Access::Admin] {
        assert!(is_unauthenticated(&tokens.admit(None, None, access)));
        assert!(is_unauthenticated(&tokens.admit(None, Some(""), access)));
        assert!(is_unauthenticated(&tokens.admit(None, Some(&robot[..robot.len() - 1]), access)));
        assert!(tokens.admit(None, Some(&admin), access).is_ok());
    }
    assert!(tokens.admit(None, None, Access::Open).is_ok());
    assert!(tokens.admit(None, Some(&robot), Access::Robot).is_ok());
    let denied = tokens.admit(None, Some(&robot), Access::Admin);
    assert!(matches!(denied, Err(ServiceError::PermissionDenied { .. })), "{denied:?}");
    tokens.storage.close().await;
}

#[tokio::test]
async fn a_token_outlives_the_server_and_only_its_hash_is_stored() {
    let directory = tempfile::tempdir().unwrap();
    let first = tokens(directory.path()).await;
    let (_, secret) = first.create("operator", Role::Admin).await.unwrap();
    first.storage.close().await;
    drop(first);
    assert!(secret.starts_with(PREFIX) && secret.len() == PREFIX.len() + 64, "{secret}");
    let file = std::fs::read(directory.path().join("waypost.sqlite")).unwrap();
    let holds = |bytes: &[u8]| file.windows(bytes.len()).any(|window| window == bytes);
    assert!(holds(&hash(&secret)) && !holds(&secret.as_bytes()[PREFIX.len()..]));
    let second = tokens(directory.path()).await;
    let admitted = second.admit(None, Some(&secret), Access::Admin).unwrap();
    second.delete("tokens/operator").await.unwrap();
    assert!(admitted.deleted.is_cancelled());
    assert!(second.admit(None, None, Access::Admin).is_ok(), "with no token left, everyone is served again");
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
    let first_robot = tokens.create("robot", Role::Robot).await.map(drop);
    assert!(refused(first_robot).contains("the first token must be an admin's"));
    tokens.create("operator", Role::Admin).await.unwrap();
    tokens.create("robot", Role::Robot).await.unwrap();
    let exists = tokens.create("robot", Role::Robot).await;
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
        tokens.create(name, Role::Admin).await.unwrap();
    }
    let names = |page: &Page<TokenRow>| {
        page.items.iter().map(|token| token.name.clone()).collect::<Vec<_>>().join(" ")
    };
    let first = tokens.list(2, "").unwrap();
    assert_eq!((names(&first).as_str(), first.next.as_str()), ("a b", "after-62"));
    let second = tokens.list(2, &first.next).unwrap();
    assert_eq!((names(&second).as_str(), second.next.as_str()), ("c", ""));
    assert!(tokens.list(2, "no/token").is_err());
    tokens.storage.close().await;
}
