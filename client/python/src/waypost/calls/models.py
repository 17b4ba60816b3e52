"""Models: training, files, lists."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Iterator, Sized
from pathlib import Path

from waypost.connection import Connection, File, chunks
from waypost.v1 import job_pb2, model_pb2

#: Training images that are too few: see the guide's page on models.
_FEW_IMAGES = 100


class ModelCalls:
    """What images are recognised by."""

    _connection: Connection

    def train_model(
        self,
        images: Iterable[bytes | str | Path],
        words: int,
        *,
        display_name: str = "",
        extractor: str | None = None,
        seed: int = 0,
    ) -> job_pb2.Job:
        """Uploads images and trains a model from them; gives the job that does so, whose result is the model.

        Args:
            images: JPEG or PNG, as bytes or as files, in the order in which they were taken: what is learnt
                of revisits and look-alikes comes from neighbours in a drive. They are never all in memory.
                What it raises is raised here, and no model is trained.
            words: Words of the vocabulary, at least 2.
            display_name: A name for people.
            extractor: As in `rootsift features=500 width=640`; the server's default if left out.
            seed: The same images, settings and seed give the same model.

        Warns:
            UserWarning: If there are fewer than 100 images: they tell little about what is new.

        Raises:
            InvalidArgument: If the server refuses the settings or an image.
        """
        settings = model_pb2.TrainModelSettings(
            display_name=display_name,
            extractor=extractor,
            words=words,
            seed=seed,
            image_count=len(images) if isinstance(images, Sized) else None,
        )

        sent = 0

        def requests() -> Iterator[model_pb2.TrainModelRequest]:
            nonlocal sent
            yield model_pb2.TrainModelRequest(settings=settings)
            for image in images:
                content = image if isinstance(image, bytes) else Path(image).read_bytes()
                yield model_pb2.TrainModelRequest(image=content)
                sent += 1

        job: job_pb2.Job = self._connection.upload(self._connection.models.TrainModel, requests())
        if sent < _FEW_IMAGES:
            warnings.warn(
                f"the model is trained on {sent} images: that tells little about what is new, and nothing "
                f"about look-alikes; {_FEW_IMAGES} and more, in the order of a drive, tell both",
                stacklevel=2,
            )
        return job

    def models(self) -> list[model_pb2.Model]:
        """All models, newest first."""
        request = model_pb2.ListModelsRequest()
        return list(
            self._connection.pages(self._connection.models.ListModels, request, lambda page: page.models)
        )

    def model(self, name: str) -> model_pb2.Model:
        """A model by its hash, the beginning of it, or a display name that only one model has.

        Raises:
            NotFound: If there is no such model.
        """
        request = model_pb2.GetModelRequest(name=name)
        found: model_pb2.Model = self._connection.call(self._connection.models.GetModel, request)
        return found

    def export_model(self, name: str, file: File) -> int:
        """Writes a model file; gives its length in bytes.

        Args:
            name: As in `model`.
            file: A file that is open for bytes, or the name of one that is not there yet.

        Raises:
            NotFound: If there is no such model.
            FileExistsError: If there is a file of that name.
        """
        request = model_pb2.ExportModelRequest(name=name)
        return self._connection.download(self._connection.models.ExportModel, request, file)

    def import_model(self, file: File, display_name: str = "") -> model_pb2.Model:
        """Brings a model file to the server. A model that is there already stays as it is.

        Raises:
            InvalidArgument: If it is no model file, or a damaged one.
        """
        requests = (
            model_pb2.ImportModelRequest(display_name=display_name, chunk=chunk) for chunk in chunks(file)
        )
        model: model_pb2.Model = self._connection.upload(self._connection.models.ImportModel, requests)
        return model

    def rename_model(self, name: str, display_name: str) -> model_pb2.Model:
        """Gives a model another display name.

        Raises:
            NotFound: If there is no such model.
            InvalidArgument: If that is no name.
        """
        request = model_pb2.RenameModelRequest(name=name, display_name=display_name)
        model: model_pb2.Model = self._connection.call(self._connection.models.RenameModel, request)
        return model

    def delete_model(self, name: str) -> None:
        """Deletes a model.

        Raises:
            NotFound: If there is no such model.
            FailedPrecondition: While a map uses it.
        """
        self._connection.call(self._connection.models.DeleteModel, model_pb2.DeleteModelRequest(name=name))
