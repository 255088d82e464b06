"""Cross-origin requests, if the operator allows them."""

from __future__ import annotations

from fastapi.middleware.cors import CORSMiddleware
from starlette.datastructures import Headers
from starlette.responses import Response

from app.errors import ProblemError, problem_response


class CorsMiddleware(CORSMiddleware):
    """Starlette's middleware, but refused preflights are problems and advertise nothing."""

    def preflight_response(self, request_headers: Headers) -> Response:
        """Answer one preflight."""
        response = super().preflight_response(request_headers)
        if response.status_code == 200:
            return response
        refused = bytes(response.body).decode().removeprefix("Disallowed CORS ")
        return problem_response(
            ProblemError(
                400,
                f"expected a cross-origin request that this service allows, got another {refused}",
                headers={"Vary": response.headers["Vary"]},
                reason="cors",
            )
        )
