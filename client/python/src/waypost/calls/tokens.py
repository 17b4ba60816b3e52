"""Tokens: who may call the server."""

from __future__ import annotations

from waypost.connection import Connection, resource
from waypost.v1 import token_pb2


class TokenCalls:
    """Who may use a server; for admins, but for the question who asks."""

    _connection: Connection

    def create_token(self, token_id: str, role: token_pb2.Token.Role) -> tuple[token_pb2.Token, str]:
        """Makes a token; gives it with its secret, which the server does not keep.

        Args:
            token_id: 1 to 63 of a-z, 0-9, - and _, beginning with a letter or digit.
            role: `token_pb2.Token.ROLE_ROBOT` or `ROLE_ADMIN`.

        Raises:
            AlreadyExists: If there is one of that name.
            FailedPrecondition: If the first token is not an admin's.
        """
        request = token_pb2.CreateTokenRequest(token_id=token_id, role=role)
        made = self._connection.call(self._connection.tokens.CreateToken, request)
        return made.token, made.secret

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
