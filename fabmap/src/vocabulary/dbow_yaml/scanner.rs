//! The words and signs of a YAML text, as far as OpenCV writes them for a vocabulary.

use std::str::FromStr;

use super::error::DbowYamlError;

/// A sign between words.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Token {
    Colon,
    Comma,
    /// Of a list's item.
    Dash,
    Open,
    Close,
    OpenBrace,
    CloseBrace,
}

impl Token {
    fn sign(self) -> char {
        match self {
            Self::Colon => ':',
            Self::Comma => ',',
            Self::Dash => '-',
            Self::Open => '[',
            Self::Close => ']',
            Self::OpenBrace => '{',
            Self::CloseBrace => '}',
        }
    }
}

/// Goes through a text from its beginning.
pub(super) struct Scanner<'a> {
    text: &'a str,
    /// Where the rest begins.
    at: usize,
    /// Where what was read last begins.
    last: usize,
}

impl<'a> Scanner<'a> {
    /// Begins behind the line with the version of YAML, and the one that begins a document.
    pub(super) fn new(text: &'a str) -> Self {
        let mut scanner = Self { text, at: 0, last: 0 };
        if text.starts_with('%') {
            scanner.at = text.find('\n').unwrap_or(text.len());
        }
        scanner.skip_blank();
        if scanner.rest().starts_with("---") {
            scanner.at += "---".len();
        }
        scanner
    }

    /// Where what follows begins, for [`Scanner::line_of`].
    pub(super) fn position(&mut self) -> usize {
        self.skip_blank();
        self.at
    }

    /// The line of what was read last.
    pub(super) fn line(&self) -> usize {
        self.line_of(self.last)
    }

    /// The line of a position, counted from 1.
    pub(super) fn line_of(&self, position: usize) -> usize {
        self.text.as_bytes().iter().take(position).filter(|&&byte| byte == b'\n').count() + 1
    }

    /// The next name with its colon; `None` at the end of the document.
    pub(super) fn name_or_end(&mut self) -> Result<Option<&'a str>, DbowYamlError> {
        self.skip_blank();
        if self.rest().is_empty() || self.rest().trim_end() == "..." {
            return Ok(None);
        }
        self.name("the name of a part").map(Some)
    }

    /// A name with its colon.
    pub(super) fn name(&mut self, expected: &'static str) -> Result<&'a str, DbowYamlError> {
        let name = self.word(expected)?;
        let begins = self.last;
        self.expect(Token::Colon, "`:`")?;
        self.last = begins;
        Ok(name)
    }

    /// A word without quotation marks, which ends before a blank or a sign.
    pub(super) fn word(&mut self, expected: &'static str) -> Result<&'a str, DbowYamlError> {
        self.begin(expected)?;
        let rest = self.rest();
        let ends = rest.find(|sign: char| sign.is_ascii_whitespace() || ":,[]{}\"".contains(sign));
        let word = &rest[..ends.unwrap_or(rest.len())];
        if word.is_empty() {
            return Err(self.unexpected(expected));
        }
        self.at += word.len();
        Ok(word)
    }

    pub(super) fn number<T: FromStr>(&mut self, expected: &'static str) -> Result<T, DbowYamlError> {
        let word = self.word(expected)?;
        word.parse().map_err(|_| self.unexpected(expected))
    }

    /// A text in quotation marks, or without, as OpenCV writes what begins with a letter.
    pub(super) fn text(&mut self, expected: &'static str) -> Result<&'a str, DbowYamlError> {
        self.begin(expected)?;
        let Some(inside) = self.rest().strip_prefix('"') else {
            let rest = self.rest();
            let text = &rest[..rest.find([',', '}', '\n']).unwrap_or(rest.len())];
            self.at += text.len();
            return Ok(text);
        };
        let Some(length) = inside.find('"') else {
            return Err(DbowYamlError::CutOff { line: self.line_of(self.text.len()), expected: "`\"`" });
        };
        self.at += length + 2;
        Ok(&inside[..length])
    }

    pub(super) fn expect(&mut self, token: Token, expected: &'static str) -> Result<(), DbowYamlError> {
        self.begin(expected)?;
        if self.take(token) { Ok(()) } else { Err(self.unexpected(expected)) }
    }

    /// Whether the next thing is this sign; it is gone over if it is.
    pub(super) fn take(&mut self, token: Token) -> bool {
        self.skip_blank();
        let Some(behind) = self.rest().strip_prefix(token.sign()) else { return false };
        // A number below 0 is no item.
        if token == Token::Dash && !behind.starts_with(|sign: char| sign.is_ascii_whitespace()) {
            return false;
        }
        self.last = self.at;
        self.at += 1;
        true
    }

    /// What was read last is not what was expected.
    pub(super) fn unexpected(&self, expected: &'static str) -> DbowYamlError {
        let found = beginning(self.text[self.last..].lines().next().unwrap_or_default());
        DbowYamlError::Unexpected { line: self.line(), found, expected }
    }

    fn rest(&self) -> &'a str {
        &self.text[self.at..]
    }

    fn begin(&mut self, expected: &'static str) -> Result<(), DbowYamlError> {
        self.skip_blank();
        self.last = self.at;
        if self.rest().is_empty() {
            return Err(DbowYamlError::CutOff { line: self.line_of(self.at), expected });
        }
        Ok(())
    }

    /// Over blanks and comments.
    fn skip_blank(&mut self) {
        loop {
            let rest = self.rest().trim_ascii_start();
            self.at = self.text.len() - rest.len();
            if !rest.starts_with('#') {
                return;
            }
            self.at += rest.find('\n').unwrap_or(rest.len());
        }
    }
}

/// Enough of a text to recognise it in a message.
pub(super) fn beginning(text: &str) -> String {
    text.chars().take(40).collect()
}
