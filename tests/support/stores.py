"""Object stores with their databases, each test its own; a few stores on one are as many hosts."""

import obstore

from steradian.core.settings import Settings
from steradian.storage.blobs.object_store import S3BlobStore
from steradian.storage.data_dir.layout import DataDirectory


def psycopg_url(url):
    """A libpq URL as SQLAlchemy takes it."""
    return "postgresql+psycopg" + url[url.index("://") :]


def settings_of(folder, seaweed, bucket, **settings):
    """What the environment of a host with that data folder says."""
    DataDirectory(folder).create()
    about = {"store": bucket, "store_endpoint": seaweed.endpoint, "database_url": "postgresql://unused"}
    return Settings.create(data=folder, **about, **settings)


def store_of(folder, seaweed, bucket, database, **settings):
    """A store as the process of that host has it."""
    return S3BlobStore(settings_of(folder, seaweed, bucket, **settings), database)


def keys(objects):
    """Names of all objects of a bucket but the one that says whose it is."""
    return sorted(each["path"] for page in obstore.list(objects) for each in page if each["path"] != "identity")
