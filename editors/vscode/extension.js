// Starts `splatgraph lsp` and connects VS Code to it. There is no build step: VS Code loads this file.

const vscode = require("vscode");
const { LanguageClient } = require("vscode-languageclient/node");

let client;

function start() {
  const command = vscode.workspace.getConfiguration("splatgraph").get("path", "splatgraph");
  const server = { command, args: ["lsp"] };
  const documentSelector = [
    { scheme: "file", language: "ron" },
    { scheme: "file", language: "glsl" },
  ];
  client = new LanguageClient("splatgraph", "splatgraph", server, { documentSelector });
  return client.start().catch((error) => {
    vscode.window.showErrorMessage(
      `Expected the program \`${command}\` to start, found: ${error.message}. Set splatgraph.path to its path.`,
    );
  });
}

async function stop() {
  const running = client;
  client = undefined;
  // A server that failed to start cannot be stopped.
  await running?.stop().catch(() => {});
}

function activate(context) {
  const restart = async () => {
    await stop();
    await start();
  };
  context.subscriptions.push(vscode.commands.registerCommand("splatgraph.restart", restart));
  return start();
}

module.exports = { activate, deactivate: stop };
