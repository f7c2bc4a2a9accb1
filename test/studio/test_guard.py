# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Access to the server, and what its responses allow in a browser."""
from __future__ import annotations

import re
import socket

import pytest
from stereo_speed.core.errors import InputError
from stereo_speed.studio.guard import Guard
from stereo_speed.studio.server import page_files, Studio, WEB


@pytest.mark.parametrize('path', ['/', '/web/app.js', '/api/state', '/api/background/left',
                                  '/api/frame/0/left', '/api/socket', '/?token=wrong',
                                  '/api/state?token=SECRET', '/nothing'])
def test_nothing_is_served_without_the_secret(client, path):
    client.headers = {}
    path = path.replace('SECRET', client.guard.secret)
    status, headers, body = client.ask('GET', path)
    assert status == 403
    assert 'Set-Cookie' not in headers
    assert client.guard.secret.encode() not in body


def test_secret_becomes_a_cookie_hidden_from_scripts_and_other_sites(client):
    client.headers = {}
    status, headers, body = client.ask('GET', f'/?token={client.guard.secret}')
    assert (status, headers['Location'], body) == (303, '/', b'')
    cookie = headers['Set-Cookie']
    assert 'HttpOnly' in cookie and 'SameSite=Strict' in cookie
    client.headers = {'Cookie': cookie.partition(';')[0]}
    assert client.ask('GET', '/')[0] == 200


def test_secrets_are_unique_and_long():
    words = {Guard().secret for _ in range(5)}
    assert len(words) == 5 and min(map(len, words)) >= 32


@pytest.mark.parametrize(('header', 'value'), [
    ('Origin', 'http://evil.example'), ('Origin', 'null'), ('Origin', 'https://127.0.0.1:PORT'),
    ('Origin', 'http://127.0.0.1:1'), ('Sec_Fetch_Site', 'cross-site'),
    ('Sec_Fetch_Site', 'same-site'), ('Host', 'evil.example:PORT'), ('Host', '127.0.0.1'),
    ('Host', 'evil.example')])
@pytest.mark.parametrize(('method', 'path'), [
    ('POST', '/api/step'), ('GET', '/api/state'), ('GET', '/api/socket')])
def test_other_sites_and_host_names_are_refused(client, space, header, value, method, path):
    """The cookie is not sufficient: the origin must be this page, at this address."""
    value = value.replace('PORT', str(client.guard.port))
    body = b'{"id": "1", "name": "add_line", "fields": {}}'
    status, _, _ = client.ask(method, path, body if method == 'POST' else None,
                              Content_Type='application/json', **{header: value})
    assert status == 403
    assert not space.draft.lines


def test_own_page_is_served(client):
    origin = f'http://127.0.0.1:{client.guard.port}'
    assert client.ask('GET', '/api/state', Origin=origin, Sec_Fetch_Site='same-origin')[0] == 200
    assert client.ask('GET', '/', Host=f'localhost:{client.guard.port}')[0] == 200


def test_every_address_checks_identity_and_origin(client):
    """Every route of the server, including new ones."""
    routes = {(route.method, re.sub(r'{\w+}', '0', route.resource.canonical))
              for route in Studio(client.guard).app().router.routes()}
    assert len(routes) > 20
    for method, path in routes:
        for who, headers in ((type(client)(client.guard, known=False), {}),
                             (client, {'Origin': 'http://example.org'}),
                             (client, {'Host': f'example.org:{client.guard.port}'})):
            assert who.ask(method, path, **headers)[0] == 403, (method, path, headers)


@pytest.mark.parametrize('path', ['/', '/web/app.js', '/api/state', '/nothing', '/web/none.js'])
def test_every_response_has_the_policy(client, path):
    _, headers, _ = client.ask('GET', path)
    policy = dict(rule.split(' ', 1) for rule in headers['Content-Security-Policy'].split('; '))
    assert policy['default-src'] == "'none'"
    assert policy['script-src'] == policy['style-src'] == policy['connect-src'] == "'self'"
    assert 'unsafe' not in headers['Content-Security-Policy']
    assert policy['frame-ancestors'] == "'none'"
    assert headers['X-Content-Type-Options'] == 'nosniff'
    assert headers['Referrer-Policy'] == 'no-referrer'


@pytest.mark.parametrize('path', [
    '/web/../server.py', '/web/..%2fserver.py', '/web/%2e%2e/server.py', '/web//etc/passwd',
    '/web/..%2f..%2fcore%2ferrors.py', '/api/background/..', '/api/background/..%2fleft',
    '/api/frame/../left', '/api/frame/-1/left', '/api/frame/0/..%2f..', '/api/runs/..%2f',
    '/api/runs/0', '/api/runs/-1', '/api/runs/0/plot/..%2fsummary.json', '/etc/passwd',
    '/web/', '/api/frame/99999999999/left', '/api/frame/%d9%a1/left'])
def test_no_path_leads_outside(client, path):
    status, _, body = client.ask('GET', path)
    assert status in (403, 404), body[:100]
    assert b'import' not in body and b'root:' not in body


def test_pages_contain_no_script_or_foreign_address():
    page = page_files()['index.html'].read_text()
    assert re.findall(r'<script(?![^>]*\bsrc=)', page) == []
    assert not re.search(r'\son\w+=|style=|<style|javascript:', page)
    for path in page_files().values():
        text = path.read_text()
        assert set(re.findall(r'https?://[\w.]+', text)) <= {'http://www.w3.org'}, path.name
        for means in ('innerHTML', 'outerHTML', 'insertAdjacentHTML', 'document.write', 'eval(',
                      'new Function', 'DOMParser'):
            assert means not in text, (path.name, means)
    assert WEB.is_dir()


@pytest.mark.parametrize('address', ['0.0.0.0', '::', 'localhost', 'evil', ''])
def test_server_does_not_listen_on_all_addresses(address):
    with pytest.raises(InputError, match='--address'):
        Guard(address)


def test_port_in_use_is_reported():
    with socket.socket() as taken:
        taken.bind(('127.0.0.1', 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(InputError, match=f'port {port} of 127.0.0.1: found .*in use'):
            Guard().bind(port)
