"""Tokens: who may call the server."""

from __future__ import annotations

from typing import TYPE_CHECKING

from waypost.connection import Connection, resource
from waypost.v1 import token_pb2

if TYPE_CHECKING:
    from collections.abc import Iterable


class TokenCalls:
    """Who may use a server; for admins, but for the question who asks."""

    _connection: Connection

    def create_token(
        self,
        token_id: str,
        role: token_pb2.Token.Role,
        *,
        abilities: Iterable[token_pb2.Token.Ability] = (),
        maps: Iterable[str] = (),
        lifetime_s: int | None = None,
        quotas: token_pb2.Quotas | None = None,
    ) -> tuple[token_pb2.Token, str]:
        """Makes a token; gives it with its secret, which the server does not keep.

        Args:
            token_id: 1 to 63 of a-z, 0-9, - and _, beginning with a letter or digit.
            role: `token_pb2.Token.ROLE_READER`, `ROLE_ROBOT` or `ROLE_ADMIN`.
            abilities: What a robot's may do, where that is less than all, as in `ABILITY_LOCALIZE`.
            maps: The maps that it reaches: names, or the beginning of names and an asterisk. All if left out.
            lifetime_s: After how many seconds it expires; never if left out.
            quotas: How much its holder may have and send, as in `token_pb2.Quotas(max_sessions=3)`.

        Raises:
            AlreadyExists: If there is one of that name.
            FailedPrecondition: If the first token is not an admin's, or is limited.
        """
        request = token_pb2.CreateTokenRequest(
            token_id=token_id, role=role, abilities=abilities, maps=maps, lifetime_s=lifetime_s, quotas=quotas
        )
        made = self._connection.call(self._connection.tokens.CreateToken, request)
        return made.token, made.secret

    def rotate_token(
        self, name: str, *, overlap_s: int | None = None, lifetime_s: int | None = None
    ) -> tuple[token_pb2.Token, str]:
        """Gives a token a new secret; gives it with that.

        Args:
            name: Name of the token.
            overlap_s: For how many seconds the secret before stays good, at most a week; an hour if left out.
            lifetime_s: After how many seconds from now it expires; when it would have, if left out.

        Raises:
            NotFound: If there is no such token.
            FailedPrecondition: If it has expired and no lifetime is given.
        """
        request = token_pb2.RotateTokenRequest(
            name=resource("tokens", name), overlap_s=overlap_s, lifetime_s=lifetime_s
        )
        rotated = self._connection.call(self._connection.tokens.RotateToken, request)
        return rotated.token, rotated.secret

    def update_token(
        self,
        name: str,
        *,
        quotas: token_pb2.Quotas | None = None,
        lifted: Iterable[token_pb2.Quotas.Kind] = (),
    ) -> token_pb2.Token:
        """Changes the quotas of a token, which keeps its secret; it holds for streams that are open, too.

        Args:
            name: Name of the token.
            quotas: Quotas as they are to be; those that are left out stay as they are.
            lifted: Quotas that are lifted, as in `token_pb2.Quotas.KIND_SESSIONS`.

        Raises:
            NotFound: If there is no such token.
            InvalidArgument: If a quota is none for the token's role.
        """
        request = token_pb2.UpdateTokenRequest(name=resource("tokens", name), quotas=quotas, lifted=lifted)
        token: token_pb2.Token = self._connection.call(self._connection.tokens.UpdateToken, request)
        return token

    def tokens(self) -> list[token_pb2.Token]:
        """All tokens, by name."""
        request = token_pb2.ListTokensRequest()
        return list(
            self._connection.pages(self._connection.tokens.ListTokens, request, lambda page: page.tokens)
        )

    def delete_token(self, name: str) -> None:
        """Deletes a token: it is refused from then on, and its streams end.

        Raises:
            NotFound: If there is no such token.
            FailedPrecondition: If the server could not be administered without it.
        """
        request = token_pb2.DeleteTokenRequest(name=resource("tokens", name))
        self._connection.call(self._connection.tokens.DeleteToken, request)

    def caller(self) -> token_pb2.Caller:
        """Who this client is to the server, and what it may do."""
        caller: token_pb2.Caller = self._connection.call(
            self._connection.tokens.GetCaller, token_pb2.GetCallerRequest()
        )
        return caller
