"""The file formats, one module a format or a closely related family of formats.

A module declares its words in `FORMATS`; `registry` lists the modules. The bytes are made in
`clacad.formats`.
"""
